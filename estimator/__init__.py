"""The library: kinematics, filter, running it over logs, and scores."""
