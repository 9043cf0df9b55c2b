"""Simulated runs with friction as truth: a scenario in, a log out.

Rooms, from the ground up: `base`, `drives`, `truth`, `sensors`; `scenario` and `simulate` combine them.
Above them stand `study`, `running` and `paper`. Imports `estimator`, never `replay`.
"""
