"""What the kernel keeps from a policy's process: files, memory, signals, privileges. Standard library only, because it
is in force before anything else is imported."""
