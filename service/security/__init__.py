"""Who may speak to the service, what each may do, how much a request may take, and the record of who did what."""
