"""The emulated robot: world, drives, and the real firmware on virtual pins."""
