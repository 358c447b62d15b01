"""The operator's console: a page in the browser, at the service's own address. `web` has its sources, `built` what is
made of them."""
