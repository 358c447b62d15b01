"""Events in memory, on their path from the threads that publish them to the streams that send them."""
