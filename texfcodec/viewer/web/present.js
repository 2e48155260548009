// Two pictures of one view on the canvas: one of them, both with a slider between, side by side, or their difference.

import { Program } from './gl.js';
import { SCREEN } from './draw.js';

export const MODES = ['single', 'other', 'split', 'side', 'difference'];
export const HOTTEST = 32; // coded levels (root mean square of R, G, B) from which on the heat map is at its hottest
export const HEAT = [[0, 0, 0], [70, 15, 110], [190, 50, 85], [250, 150, 30], [255, 255, 190]]; // from nothing to the hottest
export const ONLY_ONE = [0, 160, 170]; // where one of the two shows nothing
const glslColour = (rgb) => `vec3(${rgb.join(', ')}) / 255.0`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D u_first, u_second;
uniform vec3 u_top, u_bottom; // of the background
uniform vec2 u_size;
uniform float u_slider, u_hottest;
uniform int u_mode;
out vec4 o_colour;
vec4 shown(sampler2D picture, vec2 at) {
  vec2 size = vec2(textureSize(picture, 0));
  return texelFetch(picture, ivec2(min(at * size, size - 1.0)), 0);
}
vec3 background() { return mix(u_bottom, u_top, (gl_FragCoord.y - 0.5) / max(u_size.y - 1.0, 1.0)); }
vec3 over(vec4 colour) { return colour.rgb + (1.0 - colour.a) * background(); }
vec3 heat(float t) {
  vec3 ramp[5] = vec3[](${HEAT.map(glslColour).join(', ')});
  float place = clamp(t, 0.0, 1.0) * 4.0;
  int step = min(int(place), 3);
  return mix(ramp[step], ramp[step + 1], place - float(step));
}
void main() {
  vec2 at = gl_FragCoord.xy / u_size;
  float line = u_slider * u_size.x;
  vec3 colour;
  if (u_mode == 0) colour = over(shown(u_first, at));
  else if (u_mode == 1) colour = over(shown(u_second, at));
  else if (u_mode == 2) {
    colour = gl_FragCoord.x < line ? over(shown(u_first, at)) : over(shown(u_second, at));
    if (abs(gl_FragCoord.x - line) < 1.0) colour = vec3(0.1);
  } else if (u_mode == 3) {
    colour = at.x < 0.5 ? over(shown(u_first, vec2(2.0 * at.x, at.y))) : over(shown(u_second, vec2(2.0 * at.x - 1.0, at.y)));
  } else {
    vec4 a = shown(u_first, at), b = shown(u_second, at);
    vec3 gap = over(a) - over(b);
    if (a.a == 0.0 && b.a == 0.0) colour = background();
    else if (a.a == 0.0 || b.a == 0.0) colour = ${glslColour(ONLY_ONE)};
    else colour = heat(sqrt(dot(gap, gap) / 3.0) * 255.0 / u_hottest);
  }
  o_colour = vec4(colour, 1.0);
}`;

/** Colours of the top and the bottom row of a background. */
export function topAndBottom(background) {
  return Array.isArray(background[0]) ? background : [background, background];
}

/** A background as a style sheet has it. */
export function backgroundStyle(background) {
  return `linear-gradient(${topAndBottom(background).map((colour) => `rgb(${colour.join(' ')})`).join(', ')})`;
}

/** Draws two Targets (the second may be missing) to the frame that is bound, width x height. */
export class Presenter {
  constructor(gl) {
    this.gl = gl;
    this.program = new Program(gl, SCREEN, FRAGMENT);
  }

  show(first, second, { width, height, mode, slider = 0.5, background = [255, 255, 255], hottest = HOTTEST }) {
    const { gl, program } = this;
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
    gl.useProgram(program.handle);
    program.texture('u_first', first.colour, 0);
    program.texture('u_second', (second ?? first).colour, 1);
    program.setInteger('u_mode', second ? MODES.indexOf(mode) : 0);
    const [u_top, u_bottom] = topAndBottom(background).map((colour) => colour.map((v) => v / 255));
    program.set({ u_top, u_bottom, u_size: [width, height], u_slider: slider, u_hottest: hottest });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

/**
 * How far the second of two pictures (premultiplied bytes, RGBA) is from the first, over the pixels that both cover, laid over
 * a background: { both, only, rgb, channels: [r, g, b] }, PSNR in dB, Infinity where they are equal.
 */
export function psnrOf(first, second, background = [255, 255, 255]) {
  const sums = [0, 0, 0];
  let both = 0, only = 0;
  for (let i = 0; i < first.length; i += 4) {
    const [a, b] = [first[i + 3], second[i + 3]];
    if (a === 0 || b === 0) {
      only += a !== b;
      continue;
    }
    both++;
    for (let c = 0; c < 3; c++) {
      const gap = first[i + c] - second[i + c] + ((b - a) * background[c]) / 255;
      sums[c] += gap * gap;
    }
  }
  const decibels = (sum, count) => (count ? 10 * Math.log10((255 ** 2 * count) / sum) : NaN);
  return { both, only, rgb: decibels(sums[0] + sums[1] + sums[2], 3 * both), channels: sums.map((sum) => decibels(sum, both)) };
}
