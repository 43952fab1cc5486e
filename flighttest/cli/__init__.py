"""Words to pipeline to exit code. `show` is the only module of the package that prints."""

import os

# Before numpy is loaded. The matrices here are small: a second thread gains them nothing, and takes the core of a second process.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
