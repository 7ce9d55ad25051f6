"""The main job on the embedded default: simulate, receive, estimate, serve, and show what came out."""
