"""The robot cell behind its drivers' messages: station, guard, and a simulator of that cell."""
