"""What is read off measured surfaces: how alike two are, what a print keeps of a wave, where nothing can be read."""
