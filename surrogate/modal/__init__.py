"""The default surrogate: T = S + o(p, h) + Σ w_j r_j(p, h) + N(w; p, h), each a sum of modes with local gains."""
