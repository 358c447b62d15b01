"""The metrics that Prometheus reads at `/metrics`."""
