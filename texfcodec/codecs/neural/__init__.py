"""3DNTC: fields as small latent grids and a small network, for random access (encoder: fit; decoder: payload, infer)."""
