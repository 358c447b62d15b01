"""Tests of the examples. Two cells are shared by all of them."""
