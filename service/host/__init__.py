"""The machine: child processes, folders, processors, memory, logs."""
