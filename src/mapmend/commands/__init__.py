"""The subcommands of ``mapmend``, a module each: arguments in, calls, an exit code out. Loaded when they are called."""
