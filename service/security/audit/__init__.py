"""The audit log: who requested what, when, and with which result."""
