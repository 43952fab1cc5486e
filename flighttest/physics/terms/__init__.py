"""The catalogue of named physics: one small file per family; every module-level `Term` here is in `physics.catalogue.catalogue()`."""
