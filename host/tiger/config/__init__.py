"""robot.toml and the presets: checked, frozen models of everything a number can be."""
