"""Fixed-point control against float64, and the whole board under damaged frames, with the sanitizers on."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CPP = Path(__file__).parent / "cpp"
NATIVE = ROOT / "firmware" / "native"
FLAGS = [
    "-std=gnu++17",
    "-O1",
    "-g",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
    f"-I{ROOT / 'firmware/libraries/TigerCore/src'}",
    f"-I{NATIVE}",
]


def run(binary: Path, *arguments: str) -> dict[str, float]:
    """What the driver printed, name by name."""
    done = subprocess.run([binary, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return {name: float(value) for name, value in (line.split() for line in done.stdout.splitlines())}


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Compile a driver of the folder cpp."""
    folder = tmp_path_factory.mktemp("cpp")

    def build(name: str) -> Path:
        binary = folder / name
        subprocess.run(["g++", *FLAGS, "-o", binary, CPP / f"{name}.cpp"], check=True)
        return binary

    return build


def test_fixed_point_stays_within_a_count_of_float64_over_a_million_steps(compiled, record_figure):
    worst = run(compiled("control_reference"), "1000000")
    for name, counts in worst.items():
        record_figure(f"fixed point against float64, {name}", f"{counts:.3f}", "1")
    assert len(worst) == 6
    assert max(worst.values()) <= 1.0, worst


WRONG_ACCEPTS = 2**-14  # twice the CRC's chance, of damaged frames


def demand_no_wrong_accepts(figures: dict[str, float]) -> None:
    assert figures["wrong"] <= WRONG_ACCEPTS * figures["damaged"] + 3
    assert figures["good"] > 0.09 * figures["frames"]
    assert figures["moved"] == 0  # no ARM can carry the session and the schema hash by chance


@pytest.fixture(scope="module")
def fuzzer(compiled):
    return compiled("fuzz_frames")


def test_damaged_frames_neither_crash_the_board_nor_pass(fuzzer, record_figure):
    figures = run(fuzzer, "30000")
    record_figure(
        "wrong accepts of damaged frames", f"{figures['wrong']:.0f} of {figures['damaged']:.0f}", ""
    )
    demand_no_wrong_accepts(figures)


@pytest.mark.proof
@pytest.mark.timeout(3600)
def test_ten_million_damaged_frames_neither_crash_the_board_nor_pass(fuzzer, record_figure):
    figures = run(fuzzer, "10000000")
    record_figure(
        "wrong accepts of damaged frames", f"{figures['wrong']:.0f} of {figures['damaged']:.0f}", ""
    )
    demand_no_wrong_accepts(figures)
