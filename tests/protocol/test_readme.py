"""The frame that the README takes apart is the one that the code makes."""

from __future__ import annotations

import re
from pathlib import Path

from tiger.protocol.frame import encode_message
from tiger.protocol.messages import SuspensionSetpoint

README = (Path(__file__).parents[2] / "protocol" / "README.md").read_text(encoding="utf-8")


def test_the_worked_frame_is_right() -> None:
    rows = re.findall(r"^\| ((?:`[0-9a-f ]+` ?)+)\|", README, re.MULTILINE)
    described = [byte for row in rows for byte in re.findall(r"[0-9a-f]{2}", row)]
    frame = encode_message(SuspensionSetpoint(1000, 1, (1.5, 0.0, 0.0, -1.5)), 42)
    assert bytes.fromhex("".join(described)) == frame
