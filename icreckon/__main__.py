"""`python -m icreckon`: the command `icreckon`."""

from icreckon.cli.main import main

if __name__ == "__main__":
    main()
