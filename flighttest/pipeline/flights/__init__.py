"""Flying scripts, and all that follows a landing."""
