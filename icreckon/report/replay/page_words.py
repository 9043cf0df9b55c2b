"""Words for the symbols of a comparison's page."""

from __future__ import annotations

# Titles of the charts of learnt parameters; docs/explanation/model.md defines them.
PARAMETER_TITLES = {
    "H": "Track-speed ratio of turning on the spot, H",
    "zeta0": "Sliding index without force, ζ₀",
    "zeta1": "Sliding index, gain with the lateral force, ζ₁",
    "epsilon0": "Eccentricity index without force, ε₀",
    "epsilon1": "Eccentricity index, gain with the lateral force, ε₁",
    "epsilon_F": "Eccentricity index, gain with the force along the tracks, ε_F",
    "eta0": "Steering efficiency index without force, η₀",
    "eta1": "Steering efficiency index, gain with the lateral force, η₁",
    "eta2": "Steering efficiency index, quadratic gain, η₂",
    "right_l": "Velocity to the right per left track speed",
    "right_r": "Velocity to the right per right track speed",
    "forward_l": "Forward velocity per left track speed",
    "forward_r": "Forward velocity per right track speed",
    "turn_l": "Yaw rate per left track speed",
    "turn_r": "Yaw rate per right track speed",
    "gyro_bias": "Bias of the gyro",
    "gyro_scale": "Scale of the gyro, less 1",
    "accelerometer_bias_x": "Bias of the accelerometer, forward",
    "accelerometer_bias_y": "Bias of the accelerometer, to the left",
    "track_scale": "Scale of the track speeds, less 1",
    "track_difference": "Difference of the sprocket radii, right less left",
    "gravity_x": "Gravity along the ground, forward",
    "gravity_y": "Gravity along the ground, to the left",
}
INNOVATION_TITLES = {
    "gyro": "Gyro",
    "accelerometer_x": "Accelerometer, forward",
    "accelerometer_y": "Accelerometer, to the left",
    "position_x": "Position fixes, x",
    "position_y": "Position fixes, y",
    "heading": "Heading fixes",
}
