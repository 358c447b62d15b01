"""What notices that something hangs or has died, and what a fault leaves behind."""
