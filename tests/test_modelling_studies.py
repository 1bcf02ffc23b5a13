"""The modelling layer's studies, in short; in full with `make study`."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
STUDIES = ROOT / "notebooks" / "studies"

pytestmark = pytest.mark.skipif(not STUDIES.is_dir(), reason="needs the source tree")


def study(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"study_{name}", STUDIES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def check_coverage(kind: int, rooms: int, low: float, high: float) -> None:
    share, error, _, used = study("coverage").coverage(kind, rooms)
    assert used == rooms
    assert low <= share <= high, f"{share:.3f} ± {error:.3f}"


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_intervals_hold_the_truth(kind: int) -> None:
    """40 rooms: the standard error of the share is about 2 %."""
    check_coverage(kind, 40, 0.82, 0.97)


@pytest.mark.study
@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_intervals_hold_the_truth_in_two_thousand_rooms(kind: int) -> None:
    check_coverage(kind, 2000, 0.88, 0.92)


def test_smoothing_helps_only_where_it_can() -> None:
    smoothing = study("smoothing")
    named = dict(smoothing.CASES)

    def ratio(name: str) -> tuple[float, float]:
        correlation, noise, pair, options = named[name]
        return smoothing.compared(12, correlation, noise, pair, **options)

    value, _ = ratio("separable sigma, exact (the theorem)")
    assert value == pytest.approx(1, abs=1e-9)
    value, error = ratio("own correlation per material, exact")
    assert 0.8 < value < 1.0 + 2 * error
    assert error > 1e-4
    value, error = ratio("smooth / mle, uncorrelated, 10 % noise")
    assert value < 1.0


@pytest.mark.study
def test_smooth_is_never_worse_than_mle_by_more_than_two_percent() -> None:
    smoothing = study("smoothing")
    for name, (correlation, noise, pair, options) in smoothing.CASES.items():
        value, error = smoothing.compared(200, correlation, noise, pair, **options)
        if "uncorrelated" in name:
            assert value < 1.02, f"{name}: {value:.4f} ± {error:.4f}"
        else:
            assert value < 1 + 2 * error + 1e-9, f"{name}: {value:.4f} ± {error:.4f}"


@pytest.mark.parametrize("rooms", [20, pytest.param(500, marks=pytest.mark.study)])
def test_a_second_configuration_tells_the_curtain(rooms: int) -> None:
    configurations = study("configurations")
    for noise in configurations.NOISES if rooms > 100 else (0.0, 0.02):
        (one, joint, _), spread = configurations.rmse(configurations.errors(rooms, noise))
        assert joint <= one + (1 if rooms > 100 else 2) * spread
        if noise == 0:
            assert joint < 0.25 * one
            assert one > 0.05


def test_soft_match_leaves_the_noise_in_t(tmp_path: Path) -> None:
    soft_or_exact = study("soft_or_exact")
    results = soft_or_exact.solved()
    exact, soft = results["mle"], results["soft"]
    assert np.abs(soft_or_exact.residual(exact)).max() < 1e-6
    assert 0.5 < np.abs(soft_or_exact.residual(soft)).max() < 2.5
    assert soft_or_exact.roughness(soft.alpha) < soft_or_exact.roughness(exact.alpha)
    path = tmp_path / "soft.png"
    soft_or_exact.draw(results, str(path))
    assert path.stat().st_size > 10_000


@pytest.mark.study
def test_the_printed_study_and_the_benchmark_run() -> None:
    for command in (
        [str(STUDIES / "soft_or_exact.py")],
        [str(ROOT / "benchmarks" / "composed.py"), "--quick"],
    ):
        done = subprocess.run(
            [sys.executable, *command], capture_output=True, text=True, cwd=ROOT, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "slope" in done.stdout or "roughness" in done.stdout
