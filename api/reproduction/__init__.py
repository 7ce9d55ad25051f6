"""The paper's figures again: the study, its pictures, its numbers."""
