/** Paints photos around the eye with WebGL: the same shader as in the scene, on one triangle that fills the view. */

import { transposed } from "../scene/frames.ts";
import type { PlacedPhoto } from "../scene/paint/painter.ts";
import { MODELS, SHOWN_AT } from "../scene/paint/photo_shader.ts";
import type { Layer, WalkPainter, WalkView } from "./walk_painter.ts";

const VERTEX = `#version 300 es
uniform mat3 mapFromView;
uniform vec2 tanHalf;
out vec3 ahead;
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  ahead = mapFromView * vec3(corner * tanHalf, -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 ahead;
out vec4 shown;
uniform vec3 shift;
${SHOWN_AT}
void main() {
  vec3 ray = normalize(ahead);
  float along = dot(shift, ray);
  shown = shownAt(shift + ray * (sqrt(along * along + 1.0 - dot(shift, shift)) - along));
}`;

export class WebglSphere implements WalkPainter {
  readonly mostPixels: number;
  private readonly gl: WebGL2RenderingContext;
  private readonly program: WebGLProgram;
  private readonly textures = new Map<PlacedPhoto, WebGLTexture>();

  constructor(gl: WebGL2RenderingContext, mostPixels: number) {
    this.gl = gl;
    this.mostPixels = Math.min(mostPixels, gl.getParameter(gl.MAX_TEXTURE_SIZE) as number);
    this.program = programOf(gl);
    gl.useProgram(this.program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  resize(width: number, height: number): void {
    const { canvas } = this.gl;
    const perPixel = Math.min(window.devicePixelRatio, 2);
    [canvas.width, canvas.height] = [Math.round(width * perPixel), Math.round(height * perPixel)];
    this.gl.viewport(0, 0, canvas.width, canvas.height);
  }

  draw(layers: readonly Layer[], { mapFromView, tanHalf }: WalkView): void {
    const { gl } = this;
    this.free(layers);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniformMatrix3fv(this.at("mapFromView"), false, transposed(mapFromView).flat());
    gl.uniform2f(this.at("tanHalf"), (tanHalf * gl.canvas.width) / gl.canvas.height, tanHalf);
    for (const { photo, opacity, shift } of layers) {
      gl.bindTexture(gl.TEXTURE_2D, this.textureOf(photo));
      // A matrix is given by columns; the transpose of the photo's rotation, by columns, is that rotation by rows.
      gl.uniformMatrix3fv(this.at("cameraFromMap"), false, photo.place.rotation.flat());
      gl.uniform1f(this.at("opacity"), opacity);
      gl.uniform1f(this.at("hfov"), (photo.camera.hfov_deg * Math.PI) / 180);
      gl.uniform1f(this.at("aspect"), photo.canvas.width / photo.canvas.height);
      gl.uniform1i(this.at("model"), MODELS[photo.camera.model]);
      gl.uniform3f(this.at("shift"), ...shift);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
  }

  private at(name: string): WebGLUniformLocation | null {
    return this.gl.getUniformLocation(this.program, name);
  }

  private textureOf(photo: PlacedPhoto): WebGLTexture {
    const { gl } = this;
    const known = this.textures.get(photo);
    if (known) return known;
    const texture = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, photo.canvas);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    this.textures.set(photo, texture);
    return texture;
  }

  /** A photo that is no longer drawn leaves the memory. */
  private free(layers: readonly Layer[]): void {
    for (const [photo, texture] of this.textures) {
      if (layers.some((layer) => layer.photo === photo)) continue;
      this.gl.deleteTexture(texture);
      this.textures.delete(photo);
    }
  }
}

function programOf(gl: WebGL2RenderingContext): WebGLProgram {
  const program = gl.createProgram()!;
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`expected shaders that link, got: ${gl.getProgramInfoLog(program)}`);
  return program;
}
