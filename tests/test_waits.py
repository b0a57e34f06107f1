"""``pincal bench``: what is timed is what people wait for, and its limits do the work they say."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import done, run

from pincal.blas import on_one_thread, one_thread
from pincal.cli.waits import bare_exchange, tasks


def test_bench_times_the_tasks_that_are_named() -> None:
    """A task by its name, with its limit, as JSON."""
    found = json.loads(done("bench", "command-help", "--runs", 1, "--json").out)["waits"]
    assert [one["name"] for one in found] == ["command-help"]
    assert 0.0 < found[0]["least"] < found[0]["seconds"]
    assert "Python and NumPy" in found[0]["limit"]


def test_unknown_tasks_are_refused_with_the_known_ones() -> None:
    """No task is run."""
    outcome = run("bench", "select")
    said = " ".join(outcome.err.split())
    assert outcome.code == 2
    assert "no task 'select'" in said
    assert all(task.name in said for task in tasks())


def test_bare_exchange_beats_what_is_drawn() -> None:
    """A choice without repetition, better than 2,000 drawn at random."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((300, 5))

    def value(chosen: list[int] | np.ndarray) -> float:
        return float(np.linalg.slogdet(rows[chosen].T @ rows[chosen])[1])

    chosen = bare_exchange(rows, 12)
    assert len(set(chosen)) == 12
    assert value(chosen) > max(value(rng.permutation(300)[:12]) for _ in range(2000))


def test_blas_has_its_threads_back() -> None:
    """Within, one thread; after the last that is within, or an error, what was there before."""
    from threadpoolctl import threadpool_info, threadpool_limits

    def threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    @on_one_thread
    def nested() -> None:
        with one_thread():
            assert threads() == {1}
        assert threads() == {1}
        raise ValueError

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with pytest.raises(ValueError):
            nested()
        assert threads() == before
