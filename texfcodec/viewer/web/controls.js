// Hands on the canvas: what pointers and the wheel do to the camera and to the line between two pictures.

const DEGREES = 0.4; // a pixel of dragging turns
const WHEEL = 0.0015, PINCH_WHEEL = 0.01; // logarithm of the distance, a unit of the wheel; a track pad pinches in small units
const LINE_HEIGHT = 16, PAGE_HEIGHT = 400; // pixels, where a wheel counts in lines or pages
const NEAR_LINE = { mouse: 8, pen: 14, touch: 24 }; // pixels

/**
 * Listens to a canvas. viewer: what turns, { orbit, moved(), frame(), line, slide(share) }; line is where the line between two
 * pictures stands, a share of the width, or null where there is none.
 */
export class Controls {
  constructor(canvas, viewer) {
    Object.assign(this, { canvas, viewer, fingers: new Map(), slides: false });
    const listeners = {
      pointerdown: (event) => this.down(event), pointermove: (event) => this.move(event), pointerup: (event) => this.up(event),
      pointercancel: (event) => this.up(event), dblclick: () => viewer.frame(), contextmenu: (event) => event.preventDefault(),
    };
    Object.entries(listeners).forEach(([kind, listener]) => canvas.addEventListener(kind, listener));
    canvas.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
  }

  /** Whether a pointer is at the line. */
  atLine(event) {
    const line = this.viewer.line, { left, width } = this.canvas.getBoundingClientRect();
    return line !== null && Math.abs(event.clientX - left - line * width) < (NEAR_LINE[event.pointerType] ?? NEAR_LINE.mouse);
  }

  down(event) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.slides = this.fingers.size === 0 && event.button === 0 && !event.shiftKey && this.atLine(event);
    this.fingers.set(event.pointerId, { x: event.clientX, y: event.clientY, pans: event.button !== 0 || event.shiftKey });
  }

  up(event) {
    this.fingers.delete(event.pointerId);
    this.slides = false;
  }

  move(event) {
    const finger = this.fingers.get(event.pointerId);
    if (!finger) {
      this.canvas.classList.toggle('at-line', this.atLine(event));
      return;
    }
    const before = this.grip(), { left, width } = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - finger.x, event.clientY - finger.y];
    Object.assign(finger, { x: event.clientX, y: event.clientY });
    if (this.slides) this.viewer.slide((event.clientX - left) / width);
    else if (this.fingers.size > 1) this.pinch(before, this.grip());
    else if (finger.pans) this.pan(x, y);
    else this.viewer.orbit.turn(-x * DEGREES, y * DEGREES);
    if (!this.slides) this.viewer.moved();
  }

  /** Middle of the first two fingers, and how far they are apart. */
  grip() {
    const [a, b = a] = this.fingers.values();
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)) };
  }

  pinch(before, after) {
    this.viewer.orbit.zoom(before.apart / after.apart);
    this.pan(after.x - before.x, after.y - before.y);
  }

  pan(x, y) {
    const { height } = this.canvas.getBoundingClientRect();
    this.viewer.orbit.pan(x / height, -y / height);
  }

  wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * [1, LINE_HEIGHT, PAGE_HEIGHT][event.deltaMode];
    this.viewer.orbit.zoom(Math.exp(pixels * (event.ctrlKey ? PINCH_WHEEL : WHEEL)));
    this.viewer.moved();
  }
}
