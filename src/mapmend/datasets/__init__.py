"""Public logs by name: their addresses, their contents, and how they are fetched into the user's cache."""
