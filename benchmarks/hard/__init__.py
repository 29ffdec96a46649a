"""Hard cases of `myork bench stability`: what they are, and how what comes out is judged."""
