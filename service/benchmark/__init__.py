"""The benchmark of the service: answers under load, live scans, and how soon a stop stops the arm."""
