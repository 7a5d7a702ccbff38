"""Public logs by name: where they lie, what they are, and how they come into the user's cache."""
