// The page as a person uses it.

/** Puts a sentence where the user sees it. */
export function say(text) {
  let box = document.getElementById('message');
  if (!box) {
    box = document.createElement('p');
    box.id = 'message';
    document.body.append(box);
  }
  box.textContent = text;
}

export class Viewer {}
