"""Windows of the wheelsets of a running gear -> creep forces -> friction of the track, by place."""
