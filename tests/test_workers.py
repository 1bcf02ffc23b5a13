"""Work that is shared by workers: the same numbers, whoever computes what, and whoever dies."""

import json
import os
import pickle
import shutil
import signal
import socket
import sys
import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal import studies
from rtcal.finder import control_rooms
from rtcal.finder.means import engines
from rtcal.loop import measured_pairs
from rtcal.loop.measured_pairs import simulated_controls
from rtcal.support import workers
from rtcal.support.errors import (
    ClusterError,
    DataError,
    MissingDependencyError,
    TooShortError,
)
from rtcal.support.workers import workforce
from tests.conftest import run
from tests.test_where import measured, stated, tracing

SHOEBOX = studies.paper.SHOEBOX


@pytest.fixture(scope="module")
def cluster():
    """A scheduler on this machine, with two workers, each a process of its own."""
    distributed = pytest.importorskip("distributed", reason="needs the extra cluster")
    settings = {"threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=2, **settings) as made:
        yield made


def with_workers(cluster, number):
    """Let the cluster have a number of workers, and return its address."""
    cluster.scale(number)
    end = time.monotonic() + 60
    while len(cluster.scheduler_info["workers"]) != number:
        assert time.monotonic() < end, "the workers do not start"
        time.sleep(0.05)
    return str(cluster.scheduler_address)


# Tasks --------------------------------------------------------------------------------------------


def square(job):
    time.sleep(0.05 * (job % 3))  # the later ones end before the earlier ones
    return job * job


def in_steps(job, finished):
    for k in range(3):
        time.sleep(0.01)
        finished(k + 1)
    return job


def counted(folder, fatal, times, job):
    """Note that the job was run; the fatal one ends its worker the first times that it is run."""
    runs = len([*folder.glob(f"{job}-*")])
    (folder / f"{job}-{runs}").touch()
    if job == fatal and runs < times:
        time.sleep(1)  # what was finished before is fetched by then
        os.kill(os.getpid(), signal.SIGKILL)
    return job


def refused(job):
    raise rt.errors.of_bands(TooShortError("too short"), [2])


@pytest.mark.parametrize("where", [1, 3, "cluster"])
def test_results_steps_and_errors_come_in_the_order_of_the_jobs(where, request):
    told = []
    if where == "cluster":
        made = workforce(with_workers(request.getfixturevalue("cluster"), 2))
    else:
        made = workforce(threads=where)
    with made as some:
        squares = [*some.in_order(square, range(9), lambda *at: told.append(at))]
        assert squares == [n * n for n in range(9)]
        assert told == [(n, 9) for n in range(1, 10)]
        told.clear()
        steps = some.in_order(in_steps, range(3), lambda *at: told.append(at), steps=3)
        assert [*steps] == [0, 1, 2]
        assert told == sorted(told)
        assert {total for _, total in told} == {9}
        with pytest.raises(TooShortError, match="too short") as caught:
            next(some.in_order(refused, [0]))
        assert caught.value.bands == (2,)


def test_a_worker_that_dies_costs_its_task_alone(cluster, tmp_path):
    with workforce(with_workers(cluster, 2)) as some:
        task = partial(counted, tmp_path, 3, 1)
        assert [*some.in_order(task, range(8))] == [*range(8)]
    runs = {job: len([*tmp_path.glob(f"{job}-*")]) for job in range(8)}
    assert runs == dict.fromkeys(range(8), 1) | {3: 2}


def test_a_task_that_ends_every_worker_is_refused(cluster, tmp_path):
    with workforce(with_workers(cluster, 2)) as some:
        task = partial(counted, tmp_path, 0, 99)
        with pytest.raises(ClusterError, match=r"ended several workers of tcp.* give each worker"):
            [*some.in_order(task, range(2))]


# Schedulers that cannot be used -------------------------------------------------------------------


@pytest.mark.parametrize("address", ["node1", "tcp://node1", "node1:8786", "", 5, "http://a:1"])
def test_an_address_of_another_form_is_named(address):
    with pytest.raises(ClusterError, match="must be an address with a port"):
        studies.run(SHOEBOX, 0.05, 2, 2, scheduler=address)


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra cluster")
    monkeypatch.setattr(workers, "_PATIENCE", 0.5)
    with socket.socket() as silent:  # listens, and says nothing
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
        for listens in (False, True):
            if listens:
                silent.listen()
            said = rf"the scheduler tcp://127\.0\.0\.1:{port} does not answer .* `dask scheduler`"
            with pytest.raises(ClusterError, match=said):
                studies.run(SHOEBOX, 0.05, 2, 2, scheduler=f"tcp://127.0.0.1:{port}")


def test_a_scheduler_without_workers_is_named(cluster, monkeypatch):
    monkeypatch.setattr(workers, "_PATIENCE", 1.0)
    with pytest.raises(ClusterError, match="has no workers after 1 s: start some with `dask"):
        studies.run(SHOEBOX, 0.05, 2, 2, scheduler=with_workers(cluster, 0))


def test_what_a_scheduler_and_its_workers_cannot_do_is_named():
    address = "tcp://node1:8786"
    with pytest.raises(DataError, match=r"workers = 2 \(of this machine\) and a scheduler"):
        studies.run(SHOEBOX, 0.05, 2, 2, scheduler=address, workers=2)
    with pytest.raises(ClusterError, match=r"a worker has rtcal .* this machine rtcal 0\.0"):
        workers._on_worker("0.0", abs, 1)


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'rtcal\[cluster\]'"):
        studies.run(SHOEBOX, 0.05, 2, 2, scheduler="tcp://node1:8786")


# The same numbers ---------------------------------------------------------------------------------


def test_reference_rooms_are_the_same_from_the_cluster(cluster, monkeypatch):
    few = {name: replace(engine, setups=2) for name, engine in engines.ENGINES.items()}
    monkeypatch.setattr(engines, "ENGINES", few)
    case, _ = rt.datasets.hidden_room()
    here, there = control_rooms(case), control_rooms(case, scheduler=with_workers(cluster, 2))
    assert all(np.array_equal(a.errors, b.errors) for a, b in zip(here, there, strict=True))


def runs_of(**options):
    """Return the errors in reference simulations, and what is told of their progress."""
    told = []
    room = stated()
    made = simulated_controls(
        tracing(room, n_paths=400),
        room,
        ("t20", "edt"),
        progress=lambda *n: told.append(n),
        **options,
    )
    return made.errors, told


def test_reference_simulations_are_the_same_however_many_are_begun_at_once(monkeypatch):
    """Each needs longer paths than those before it, so that nearly all of them begin too short."""
    rising = lambda names, values, tracer, alpha: 1.5 + 3 * tracer.scattering.mean()  # noqa: E731
    monkeypatch.setattr(measured_pairs, "ahead_factor", rising)
    one, told = runs_of()
    assert told == [(n, 16) for n in range(1, 17)]
    traced = []
    of_run = measured_pairs._of_run

    def noted(*arguments):
        traced.append(arguments[-1].run)
        return of_run(*arguments)

    monkeypatch.setattr(measured_pairs, "_of_run", noted)
    monkeypatch.setattr(measured_pairs, "workforce", lambda *_, **__: workforce(threads=3))
    three, told_again = runs_of()
    assert np.array_equal(one, three)
    assert told == told_again
    assert len(traced) > 16  # otherwise no guess was wrong, and the test shows nothing


def test_a_tracing_is_sent_without_its_paths():
    room = stated()
    tracer = tracing(room, n_paths=400)
    before = tracer.observe(room.alpha, seed=3).values
    content = pickle.dumps(tracer)
    assert len(content) < 100_000 < sum(paths.nbytes for paths in tracer._traced.values())
    assert np.array_equal(pickle.loads(content).observe(room.alpha, seed=3).values, before)


def room_with_pairs(folder):
    box = tracing(stated())
    scene = rt.Scene(sources=dict(box.sources), receivers=dict(box.receivers))
    stated().replace(scene=scene, scattering=np.full((6, 3), 0.4)).save(folder / "room.toml")
    measured(True).save(folder / "pairs.csv")


def archive(folder):
    room, _ = rt.datasets.bras_cr2()
    times, rng = rt.Eyring().reverberation_time(room), np.random.default_rng(1)
    for n in range(5):
        drawn = times * np.exp(0.1 * rng.standard_normal(times.shape))
        (folder / f"{n}").mkdir()
        rt.calibrate(room.replace(name=f"room {n}"), drawn).save(folder / f"{n}" / "result.json")


def case(folder):
    rt.datasets.hidden_room("identified")[0].save(folder / "case.json")


POSITIONS = ("room.toml", "pairs.csv", "--paths", "400")
COMMANDS = {
    "study": (lambda _: None, ("study", "--realisations", "400", "--trials", "200")),
    "learn": (archive, ("learn", ".")),
    "find": (case, ("find", "case.json")),
    "fit": (room_with_pairs, ("fit", *POSITIONS)),
    "diagnose": (room_with_pairs, ("diagnose", *POSITIONS)),
}


@pytest.mark.parametrize(
    "name", ["study", "learn", *(pytest.param(n, marks=pytest.mark.long) for n in [*COMMANDS][2:])]
)
def test_a_command_prints_the_same_with_any_number_of_workers(
    name, cluster, tmp_path, monkeypatch, capsys
):
    make, arguments = COMMANDS[name]
    stated = tmp_path / "stated"
    stated.mkdir()
    make(stated)
    printed = list[Any]()
    for number in (None, 1, 2, 3):
        folder = shutil.copytree(stated, tmp_path / f"{number}")
        monkeypatch.chdir(folder)
        more = () if number is None else ("--scheduler", with_workers(cluster, number))
        assert run(*arguments, *more, "--json") in (0, 7)
        printed.append(json.loads(capsys.readouterr().out))
    assert printed[0]
    assert all(each == printed[0] for each in printed[1:])
