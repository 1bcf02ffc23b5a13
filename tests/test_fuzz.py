"""Broken files give a typed error that names the place, or a right reading; nothing else."""

import pytest
from hypothesis import HealthCheck, given, settings

from tests import fuzz

EXAMPLES = 500


@pytest.mark.long
@settings(
    max_examples=EXAMPLES,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(fuzz.broken())
def test_broken_files(tmp_path, case):
    fuzz.check(*case, tmp_path)


@pytest.mark.parametrize("name", sorted(fuzz.READERS))
def test_the_good_files_are_read(name, tmp_path):
    for seed in fuzz.READERS[name].seeds:
        assert fuzz.check(name, seed, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(fuzz.READERS))
def test_what_the_fuzzer_kept_is_read_or_refused(name, tmp_path):
    contents = fuzz.kept(name)
    assert contents
    for content in contents:
        fuzz.check(name, content, tmp_path)
