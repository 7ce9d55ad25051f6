"""Conicities of wheelsets by section in; what belongs to rails and what to wheels out."""
