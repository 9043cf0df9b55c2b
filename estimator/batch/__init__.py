"""Many filters at once: the steps of the filter, compiled for vector registers, one filter a lane."""
