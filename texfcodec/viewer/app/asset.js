// What stands in the scene: the group that a loader gives, where it is, and what the panel says of it.

import {AnimationMixer, Box3, Group, Sphere, Vector3} from 'three';
import {CHANNEL_MAPS, disposeGroup} from 'texf/three';

import {prepare} from './shown_layers.js';

const SAMPLED = 50000; // vertices by which a picture is framed

export class Asset {
  /** group: of TEXFLoader or GLTFLoader; facts: {name, bytes, kind: 'stream' or 'mesh', clips: animations of a GLB, warnings}. */
  constructor(group, facts) {
    Object.assign(this, facts, {group, meshes: [], root: new Group()});
    const others = [];
    group.traverse((object) => (object.isMesh ? this.meshes : object.isLight || object.isCamera ? others : []).push(object));
    others.forEach((other) => other.removeFromParent());
    this.stream = group.userData.fields ? group : group.children.find((child) => child.userData.fields) ?? null; // a GLB may carry one
    if (this.stream) this.kind = 'stream';
    this.materials = [...new Set(this.meshes.flatMap(({material}) => material))];
    this.materials.forEach(prepare);
    this.points = pointsOf(this.meshes, group);
    this.sphere = sphereOf(this.points);
    this.root.add(group);
    this.mixer = this.clips?.length ? new AnimationMixer(group) : null;
    this.mixer?.clipAction(this.clips[0]).play();
  }

  /** Stands where the centre and radius of a sphere become 0 and 1. */
  place({center, radius}) {
    this.root.scale.setScalar(1 / radius);
    this.root.position.copy(center).multiplyScalar(-1 / radius);
    this.materials.forEach((material) => {
      if ('attenuationDistance' in material) material.attenuationDistance = (material.userData.attenuation ??= material.attenuationDistance) / radius;
    });
  }

  get isLit() {
    return this.materials.some((material) => material.isMeshStandardMaterial);
  }

  /** Names of the channels that its materials have. */
  get channels() {
    const names = this.materials.flatMap((material) => material.userData.channels ?? ['base_colour', ...CHANNEL_MAPS
      .filter(([property]) => material[property]).flatMap(([, channels]) => channels)]);
    const isOpaque = this.materials.every(({transparent, alphaTest}) => !transparent && !alphaTest);
    return [...new Set(names.map((name) => name?.replace('_object', '')))].filter((name) => name && !(isOpaque && name === 'alpha'));
  }

  get textures() {
    const own = this.stream?.userData.textures ?? [];
    return [...new Set([...own, ...this.materials.flatMap((material) => Object.values(material).filter((value) => value?.isTexture))])];
  }

  /** Throws for an image that is larger than the device takes. */
  check(most) {
    const large = this.textures.find(({image}) => image && Math.max(image.width, image.height) > most);
    if (large) throw new Error(`An image has ${large.image.width} x ${large.image.height}; this device takes at most ${most}.`);
  }

  free() {
    this.textures.forEach((texture) => texture.dispose());
    if (this.stream) disposeGroup(this.stream);
    this.meshes.forEach(({geometry}) => geometry.dispose());
    this.materials.forEach((material) => material.dispose());
    this.root.removeFromParent();
  }
}

/** Places of some vertices, float64 [M * 3]. */
function pointsOf(meshes, group) {
  const out = [], place = new Vector3(), count = meshes.reduce((sum, {geometry}) => sum + (geometry.attributes.position?.count ?? 0), 0);
  const step = Math.max(1, Math.floor(count / SAMPLED));
  group.updateMatrixWorld(true);
  for (const mesh of meshes) {
    for (let i = 0; i < (mesh.geometry.attributes.position?.count ?? 0); i += step) out.push(...mesh.getVertexPosition(i, place).applyMatrix4(mesh.matrixWorld).toArray());
  }
  return Float64Array.from(out);
}

function sphereOf(points) {
  const box = new Box3().setFromArray(points), sphere = new Sphere(new Vector3(), 1), place = new Vector3();
  if (!points.length) return sphere;
  box.getCenter(sphere.center);
  let most = 0;
  for (let i = 0; i < points.length; i += 3) most = Math.max(most, place.fromArray(points, i).distanceToSquared(sphere.center));
  sphere.radius = Math.sqrt(most) || 1;
  return sphere;
}
