"""3DNTC: fields as small latent grids and a small network, for random access (encoder: fit; decoder: payload, infer).

| code | class | meaning |
|---|---|---|
| TXF-S50 | StreamError | a network parameter is not a number, infinite or of magnitude 2**12 or more |
| TXF-L10 | LimitError | the payload has more latents than limits.latents |
| TXF-I54 | InputError | the budget of resident bytes holds no grid of latents |
| TXF-I55 | InputError | the checkpoint is of another fit, or cannot be read |
"""
