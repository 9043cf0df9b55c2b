"""Ground truth: trajectories, true motion, sensors and scenarios."""
