"""Access to the service: who may call what, how large a request may be, and the audit log."""
