"""Access to the service: authentication, roles, limits of requests, headers of answers, and the audit log."""
