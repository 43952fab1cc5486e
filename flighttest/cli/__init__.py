"""Words to pipeline to exit code. `show` is the only module of the package that prints."""
