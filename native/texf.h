/* Decoder of .texf streams (bitstream_spec.md), the C interface. Everything else is in core.hpp. */
#ifndef TEXF_H
#define TEXF_H
#include <stddef.h>
#include <stdint.h>
#ifdef __cplusplus
extern "C" {
#endif
#pragma GCC visibility push(default)

/* Version of this interface: a host that has loaded the library compares texf_version() with the one that it was written for. */
#define TEXF_INTERFACE 1
uint32_t texf_version(void);

/* What texf_decode() returns, the exit codes of every decoder of this project. */
enum { TEXF_OK = 0, TEXF_INVALID = 3, TEXF_INTERNAL = 4, TEXF_UNSUPPORTED = 5, TEXF_LIMIT = 6, TEXF_STOPPED = 130 };

/* Clause 10: what a stream may ask for; 0 is no limit. */
typedef struct texf_limits {
  uint64_t file_bytes, vertices, faces, voxels, texels, samples, latents, metadata_bytes;
} texf_limits;

typedef struct texf_asset texf_asset;

/* Why a stream is refused. finding: 100 times the exit code, and the number of the code in docs/guide/errors.md: 322 is TXF-S22, 0 is
   no refusal; value, allowed: what the stream has, and what it may have, where `has_value` is 1. */
typedef struct texf_refusal {
  int32_t finding, has_value;
  uint64_t value, allowed;
  char sentence[232];
} texf_refusal;

/* Limits of level 3 (10.1), what every decoder of this project takes by default. */
texf_limits texf_usual_limits(void);

/* Decodes `size` bytes, `lod` levels less than there are (8.3). limits may be NULL: the usual ones. Of a stream that is refused
   *asset is NULL and `refusal`, where it is not NULL, says why. */
int texf_decode(const uint8_t* data, size_t size, int lod, const texf_limits* limits, texf_asset** asset, texf_refusal* refusal);

/* As texf_decode(), but of the attribute units those alone whose bit is set: bit i of `chosen` is the stream's i-th, bit 31 stands
   for all from the 32nd on. Others have no values, and fields with none but others no keys. So several callers decode a stream side by
   side, each its part: no unit needs another. */
int texf_decode_chosen(const uint8_t* data, size_t size, int lod, const texf_limits* limits, uint32_t chosen, texf_asset** asset,
                       texf_refusal* refusal);

/* As texf_decode(), on up to `threads` threads: the same values, and the same refusal. */
int texf_decode_threads(const uint8_t* data, size_t size, int lod, const texf_limits* limits, int threads, texf_asset** asset,
                        texf_refusal* refusal);
void texf_free(texf_asset* asset);

/* Decodes that the calling thread begins from here on return TEXF_STOPPED soon after another thread has set *flag to other than 0.
   NULL: nothing stops them. The flag must live until they return. */
void texf_set_stop(const int32_t* flag);

/* Arrays of an asset, in the machine's byte order (little endian wherever this has been built). */
enum texf_array_kind {
  TEXF_DESCRIPTION,   /* char: JSON, all that is not an array: cube, channel groups, materials, units, fields, evaluators */
  TEXF_METADATA,      /* char: metadata_json as it stands in the stream, nothing where there is none */
  TEXF_POSITIONS,     /* uint32 [vertices, 3] of geometry unit i: lattice positions */
  TEXF_UVS,           /* int32 [vertices, 2] of geometry unit i, nothing over voxels */
  TEXF_FACES,         /* uint32 [faces, 3] of geometry unit i: vertices */
  TEXF_NORMALS,       /* float [3 * faces, 3] of geometry unit i: shading normals of its corners (8.4), made when asked for */
  TEXF_KEYS,          /* uint64 [cells] of field i: Morton keys at the level of detail */
  TEXF_VALUES,        /* uint8 [cells, components] of field i and channel group j, nothing where the field has none */
  TEXF_SHARP_EDGES,   /* uint8 [edges]: marks of 8.4.2 */
  TEXF_CODED_NORMALS, /* int16 [groups, 3] of 8.4.4 */
  TEXF_IMAGE,         /* uint8 [rows, columns, components] of texel field i and group j: values, others filled from beside */
  TEXF_LATENTS,       /* uint8 [rows * features / 2]: INT4 latents of 3DNTC in the resident form (11.8), whatever form was sent */
  TEXF_NETWORK,       /* uint16 [parameters]: network_data of 3DNTC, binary16 */
  TEXF_LATENT_KEYS,   /* uint64 [rows]: Morton keys of field i at level j of the latents, nothing where that is hashed */
};

/* The array, which the asset keeps until it is freed, and how many bytes it has; NULL and 0 where there is none. */
const void* texf_array(texf_asset* asset, int kind, uint32_t i, uint32_t j, size_t* bytes);

#pragma GCC visibility pop
#ifdef __cplusplus
}
#endif
#endif
