"""What the kernel keeps from a policy's process: files, signals, memory, privileges."""
