"""Stages, one file each; what is done for all of them alike; the jobs that run them, and the scheduler."""
