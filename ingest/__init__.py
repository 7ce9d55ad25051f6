"""From the wire to SI: frames, logs, buses, windows; and the simulator on the far side of the bus."""
