"""Conicities of wheelsets by section in; what belongs to the rails of each section and to each wheelset's wheels out."""
