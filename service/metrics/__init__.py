"""The metrics of the service, which Prometheus reads at `/metrics`."""
