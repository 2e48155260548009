// Files that are dropped on the page.

import { element } from './dom.js';

/** Shows what is dropped anywhere on the page; viewer: of viewer.js. */
export function listenToDrops(viewer) {
  const place = element('div', { id: 'drop', hidden: true }), hasFirst = () => viewer.stage?.filled.length > 0;
  const area = () => viewer.canvas.getBoundingClientRect();
  const isSecond = ({ shiftKey, clientX }) => hasFirst() && (shiftKey || clientX > area().left + area().width / 2);
  const holdsFile = (event) => event.dataTransfer?.types.includes('Files');
  document.body.append(place);
  document.addEventListener('dragover', (event) => {
    if (!holdsFile(event)) return;
    event.preventDefault();
    mark(place, area(), isSecond(event), hasFirst());
  });
  document.addEventListener('dragleave', (event) => { place.hidden ||= event.relatedTarget === null; });
  document.addEventListener('drop', (event) => {
    if (!holdsFile(event)) return;
    event.preventDefault();
    place.hidden = true;
    if (event.dataTransfer.files.length) viewer.open(event.dataTransfer.files[0], isSecond(event) ? 1 : 0);
  });
}

/** Shows where a file falls that is over the page: on a half of the picture, or on all of it. */
function mark(place, { left, width }, isSecond, isHalf) {
  const half = width / 2;
  Object.assign(place.style, { left: `${left + (isSecond ? half : 0)}px`, width: `${isHalf ? half : width}px` });
  Object.assign(place, { hidden: false, textContent: isSecond ? 'Compare with this' : 'Show this' });
}
