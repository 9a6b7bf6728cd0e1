"""The gyro's bias, measured while the robot stands still before it is armed.

A BNO055 comes up with a bias of up to a degree per second, another one at each power-up; no stored value
helps. So the daemon measures it from the raw readings and sets it in the Nano's RAM. It is never done while
armed.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from tiger.protocol.messages import NODE, PARAMS, BoardKind, ParamSet

if TYPE_CHECKING:
    from tiger.record import ImuRawSample, Three

WINDOW_S = 1.0
SAMPLES_LEAST = 50
STILL_GYRO_RADPS = math.radians(0.35)  # standard deviation; the sensor's own noise is 0.1 degrees/s
STILL_ACCEL_MPS2 = 0.15
BIAS_MOST_RADPS = math.radians(4.0)  # the data sheet allows 3: more is a turning robot

_BY_NAME = {param.name: param for param in PARAMS[BoardKind.NANO_IMU]}


class RestCalibration:
    """Collects raw readings; `bias` is their mean once a second of them shows nothing but noise."""

    def __init__(self) -> None:
        self._window: deque[ImuRawSample] = deque()

    def add(self, sample: ImuRawSample) -> None:
        """Take one raw sample."""
        window = self._window
        if window and not 0.0 < sample.t_s - window[-1].t_s < 0.2:
            window.clear()  # a reset of the board, or a gap
        window.append(sample)
        while sample.t_s - window[0].t_s > WINDOW_S:
            window.popleft()

    def clear(self) -> None:
        """Forget what was collected."""
        self._window.clear()

    def bias(self) -> Three | None:
        """Mean angular rate about x, y and z in rad/s; None unless the last second was still."""
        window = self._window
        if len(window) < SAMPLES_LEAST or window[-1].t_s - window[0].t_s < 0.95 * WINDOW_S:
            return None
        gyro = np.array([sample.gyro_radps for sample in window])
        accel = np.array([sample.accel_mps2 for sample in window])
        mean = gyro.mean(axis=0)
        moving = gyro.std(axis=0).max() > STILL_GYRO_RADPS or accel.std(axis=0).max() > STILL_ACCEL_MPS2
        if moving or np.abs(mean).max() > BIAS_MOST_RADPS:
            return None
        x, y, z = mean.tolist()
        return x, y, z


def bias_messages(bias_radps: Three) -> list[ParamSet]:
    """The messages that set a gyro bias in the Nano and mark it calibrated, until its next reset."""
    node = NODE[BoardKind.NANO_IMU]
    bias, calibrated = _BY_NAME["gyro_bias_radps"], _BY_NAME["calibrated"]
    messages = [
        ParamSet(node, bias.index + axis, round(value / bias.scale)) for axis, value in enumerate(bias_radps)
    ]
    return [*messages, ParamSet(node, calibrated.index, 1)]
