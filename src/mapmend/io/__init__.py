"""Files in and out; nothing here knows an algorithm."""
