"""Robot files, filter variants, and settings.

In: robot files (TOML; some ship in `robots/`). Out: checked configuration, and the motion model of a
variant. Below: `motion`, `base`.
"""
