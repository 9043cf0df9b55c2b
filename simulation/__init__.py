"""Simulated runs with friction as truth: a scenario in, a log out.

Rooms, from the ground up: `base`, `drives`, `truth`, `sensors`; `scenario` and `simulate` put them
together; then `study`, `running` and `paper`. Imports `estimator`, never `replay`.
"""
