// What the report uses of three.js; esbuild leaves out the rest.
export {
  AmbientLight, BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, FrontSide,
  LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, MeshBasicMaterial, OrthographicCamera, PerspectiveCamera,
  Scene, Vector3, WebGLRenderer, EdgesGeometry,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
