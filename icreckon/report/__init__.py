"""Pages, figures and tables for users, made from results only."""
