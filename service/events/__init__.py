"""What happens, told as it happens: written with what it tells of, and sent to those who follow."""
