"""One module for each subcommand of `icreckon`; imported only when it is called."""
