"""Pages, figures and tables: all that is shown to people, made from results and from nothing else."""
