"""What the robot's sensors make of the truth: offset, bias, noise, bandwidth, steps and tooth errors."""
