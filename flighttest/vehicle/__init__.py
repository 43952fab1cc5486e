"""vehicle.yaml and the fingerprint of a vehicle. Must not talk to one."""
