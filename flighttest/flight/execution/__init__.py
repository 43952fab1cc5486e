"""In the air: state machine and scheduler, legs, resets, supervisor, and the gate that every target passes."""
