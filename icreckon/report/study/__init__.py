"""Folder, page, figures and words of a study."""
