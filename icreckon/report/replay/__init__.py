"""Folder, page, figure and table of a replay."""
