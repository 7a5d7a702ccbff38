"""Reading and writing of files; nothing here depends on an algorithm."""
