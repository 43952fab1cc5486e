"""The process that `start_simulator` starts: `python -m flighttest.sim PROTOCOL DESCRIPTOR OPTIONS [PEER]`. People use `flighttest sim`."""

import sys

from flighttest.sim.options import SimOptions
from flighttest.sim.simulation import serve_inherited

if __name__ == "__main__":
    serve_inherited(sys.argv[1], int(sys.argv[2]), SimOptions.from_json(sys.argv[3]), *sys.argv[4:])
