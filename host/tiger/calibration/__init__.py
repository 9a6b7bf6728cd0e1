"""Calibration: what a person and the robot do together, so that its readings mean what they say.

`procedure` is the state machine that all of them share, `imu`, `accel`, `level`, `strokes` and `wheels` are
the single ones; none of these has a clock or a port. `station` lets time pass on a real or an emulated robot,
`parameters` keeps the results on the board, `person` does the manual part on the emulated robot, and `runner`
brings them together.
"""
