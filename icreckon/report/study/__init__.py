"""Folder, page, figures and text of a study."""
