"""Motion models: body velocity from track speeds, with derivatives.

The paper's ICR kinematics and index models on top of them. Symbols and axes are the paper's. Below:
`tracing`, `base`.
"""
