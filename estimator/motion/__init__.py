"""Motion models: body velocity from track speeds, with derivatives.

The paper's ICR kinematics, index models on top of them, and friction at the contact points with its
stationary and its integrated motion. Symbols and axes are the paper's. Below: `tracing`, `base`.
"""
