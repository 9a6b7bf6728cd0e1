"""Figure 6.16: the rattle space is kept at every speed, and what that costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tiger.studies import speed_sweep


@pytest.mark.timeout(300)
def test_mean_cuts_and_rattle_space_over_the_speeds(tmp_path: Path) -> None:
    report = speed_sweep.run(step_mps=5.0, seed=11)
    cut = np.asarray(report.series["cut_percent"]).mean(axis=0)
    assert (cut >= [78, 90, 90, 73, 86, 85, 58]).all()
    assert np.asarray(report.series["peak_mu"]).max() < 0.95
    assert speed_sweep.plot(report, tmp_path)[0].stat().st_size > 1000


def test_fixed_weights_break_the_rattle_space_at_speed() -> None:
    report = speed_sweep.run(slowest_mps=35.0, fastest_mps=35.0, schedule=False)
    assert np.asarray(report.series["peak_mu"]).max() > 1.0
