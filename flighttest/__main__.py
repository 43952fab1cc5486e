"""`python -m flighttest`: the same program as `flighttest`."""

from flighttest.cli.main import main

if __name__ == "__main__":
    main()
