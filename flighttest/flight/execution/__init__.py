"""In the air: state machine and scheduler, legs, resets, and the supervisor when a target was refused."""
