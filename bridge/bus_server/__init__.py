"""A simulated CAN bus for other processes: servers, mirrors, logs and traffic."""
