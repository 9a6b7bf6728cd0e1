"""TigerCore compiled for the PC: the boards on virtual pins, and the attitude filter."""
