"""Structure without a name: what a residual holds beside noise, by forms that need no library, and where."""
