"""Tests of the console. The browser, a cell and a result are shared by all of them."""
