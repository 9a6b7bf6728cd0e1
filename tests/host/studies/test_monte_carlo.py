"""Monte Carlo: repeatable, the same here and on a cluster, and what the robust design stands."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.errors import ConfigError
from tiger.studies import monte_carlo

SPREAD = monte_carlo.Spread(com=0.2, mass=0.3, spring=0.2, delay_ms=5.0, delay_spread_ms=2.0)


def test_a_run_depends_on_its_seed_alone() -> None:
    together = monte_carlo.sample("table-6-1", "robust", "C", SPREAD, [3, 4])
    alone = monte_carlo.sample("table-6-1", "robust", "C", SPREAD, [4])
    assert together[1] == pytest.approx(alone[0], rel=1e-6)
    assert together[0] != pytest.approx(together[1])


def test_robust_design_is_stable_keeps_the_rattle_space_and_loses_little() -> None:
    report = monte_carlo.run(runs=12, jobs=1)
    value = {row.name: row.value for row in report.rows}
    assert value["stable"] == 100
    assert value["peak mu of any run"] < 1
    for body in monte_carlo.BODY:
        assert value[f"rms {body} cut, points lost in the median"] <= 5
    assert value["delay margin beyond the designed delay"] > 2


def test_unknown_design_is_refused() -> None:
    with pytest.raises(ConfigError, match="robust, holding"):
        monte_carlo.run(runs=1, design="perfect")


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.timeout(120)
def test_cluster_of_two_workers_on_loopback_gives_the_same_figures() -> None:
    """A real scheduler and two worker processes."""
    distributed = pytest.importorskip("distributed")
    here = monte_carlo.run(runs=4, jobs=1)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        there = monte_carlo.run(runs=4, cluster=cluster.scheduler_address)
    for name, values in here.series.items():
        assert np.asarray(there.series[name]) == pytest.approx(np.asarray(values), rel=1e-9), name


@pytest.mark.proof
@pytest.mark.timeout(3600)
def test_thousand_vehicles() -> None:
    value = {row.name: row.value for row in monte_carlo.run(runs=1000, first_seed=5000).rows}
    assert value["stable"] == 100
    assert value["peak mu of any run"] < 1
    for body in monte_carlo.BODY:
        assert value[f"rms {body} cut, points lost in the median"] <= 5
