"""Filters for microcontrollers: a folder of C sources for one robot and variant."""
