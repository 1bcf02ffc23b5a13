"""A finding states claims made, claims right and the interval, as the benchmark counts them."""

import re

import pytest
from scipy.stats import binom

from benchmarks import records as benchmark
from rtcal.finder import records
from rtcal.finder.records import Share, record_of
from rtcal.report.finding_words import interval, record_of_means

VERDICTS = ("none", "hint", "named", "family", "ambiguous", "unknown")


def test_the_file_is_what_the_benchmark_writes():
    assert benchmark.FILE.read_text(encoding="utf-8") == benchmark.text()


@pytest.mark.parametrize("counts", [(0, 7), (7, 7), (3, 18), (79, 80)])
def test_the_interval_is_that_of_the_binomial_distribution(counts):
    """At either end as many claims, or fewer and more, have a probability of 2.5 %."""
    share = Share(*counts)
    low, high = share.interval
    k, n = counts
    assert low == 0 if k == 0 else binom.sf(k - 1, n, low) == pytest.approx(0.025)
    assert high == 1 if k == n else binom.cdf(k, n, high) == pytest.approx(0.025)


@pytest.mark.parametrize("data", [records.TIMES, records.ALL, records.RUN])
@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_record_of_means_has_counts_and_an_interval(verdict, data):
    said = record_of_means(verdict, data)
    assert "tested in simulated rooms that were not used to develop it" in said
    assert data.replace(", C80", " or with C80") in said
    record = record_of("means", data)
    if (right := record.get(verdict)) is not None:
        assert re.search(rf"\b{right.count} of {right.of} [^,]* \({interval(right)}\)", said)
    assert "95 % interval" in said
