"""The operator's console: a page in the browser, at the address of the service.

`web` has its sources, `built` the page that is made of them.
"""
