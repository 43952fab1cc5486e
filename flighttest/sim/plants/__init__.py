"""The moving vehicle: the paper's, one from its rotors up, and composed models; battery, load and weather."""
