"""What the service lets be seen of itself: logs, metrics, and whether it is ready."""
