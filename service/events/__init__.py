"""Events in memory: from the threads that publish them to the streams that send them."""
