"""All effects that a model may lack: what they would change in these recordings, and what speaks for each."""
