"""The generator is a program, not part of the package: let its tests import it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "protocol"))
