// What the tracker must know of a camera, which no browser tells: how wide it sees, and how its lines are exposed.

/**
 * @typedef {object} Kind
 * @property {string} name
 * @property {number} fov degrees, along the longer side of the picture
 * @property {number} readout_ms from the first line to the last
 * @property {boolean} handset whether the sensor is mounted as in phones, so that its lines turn with the screen
 */

/** Typical ones; a page's user chooses one, or gives numbers. @type {Kind[]} */
export const kinds = [
  {name: 'Phone, main camera', fov: 66, readout_ms: 25, handset: true},
  {name: 'Phone, main camera, stabilised (cropped)', fov: 58, readout_ms: 20, handset: true},
  {name: 'Phone, wide camera', fov: 100, readout_ms: 20, handset: true},
  {name: 'Tablet', fov: 60, readout_ms: 25, handset: true},
  {name: 'Laptop or USB webcam', fov: 62, readout_ms: 30, handset: false},
  {name: 'Global shutter, 60 degrees', fov: 60, readout_ms: 0, handset: false},
];

/**
 * Which lines of the picture as shown are exposed one after the other, and in which direction. A handset's sensor has
 * its first line at the right side of the upright phone; the angle is that of screen.orientation.
 * @param {boolean} handset @param {number} angle degrees @returns {{axis: 'rows'|'columns', sign: 1|-1}}
 */
export function shutterOf(handset, angle) {
  if (!handset) return {axis: 'rows', sign: 1};
  switch (angle) {
    case 90:
      return {axis: 'rows', sign: 1};
    case 180:
      return {axis: 'columns', sign: 1};
    case 270:
      return {axis: 'rows', sign: -1};
    default:
      return {axis: 'columns', sign: -1};
  }
}
