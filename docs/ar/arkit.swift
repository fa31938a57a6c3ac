// Collects frames of an ARKit session, localizes them with panoloc and anchors content: docs/ar.md

import ARKit

struct Shot {
    let jpeg: Data
    let camera: [String: Any]
    let turn: simd_quatf
}

struct Answer: Decodable {
    struct Motion: Decodable { let matrix: [[Float]] }
    let status: String
    let warnings: [String]
    let map_from_session: Motion?
}

final class PlaceFinder: NSObject, ARSessionDelegate {
    private(set) var shots: [Shot] = []
    private var last: TimeInterval = 0

    func session(_ session: ARSession, didUpdate frame: ARFrame) {
        guard shots.count < 6, frame.timestamp - last > 1, case .normal = frame.camera.trackingState else { return }
        let q = simd_quatf(frame.camera.transform)
        // New only when turned by 30 degrees from every other: cos(30° / 2) = 0.966.
        guard shots.allSatisfy({ abs(simd_dot($0.turn.vector, q.vector)) < 0.966 }) else { return }
        let image = CIImage(cvPixelBuffer: frame.capturedImage)
        let sRGB = CGColorSpace(name: CGColorSpace.sRGB)!
        guard let jpeg = CIContext().jpegRepresentation(of: image, colorSpace: sRGB) else { return }
        shots.append(Shot(jpeg: jpeg, camera: entry(frame.camera), turn: q))
        last = frame.timestamp
    }

    func entry(_ camera: ARCamera) -> [String: Any] {
        let k = camera.intrinsics                    // column by column
        let t = camera.transform.columns.3
        let q = simd_quatf(camera.transform)
        return [
            "model": "pinhole",
            "width_px": Int(camera.imageResolution.width), "height_px": Int(camera.imageResolution.height),
            "fx_px": k[0][0], "fy_px": k[1][1], "cx_px": k[2][0], "cy_px": k[2][1],
            "session_from_camera": [
                "position_m": ["x": t.x, "y": t.y, "z": t.z],
                "quaternion": ["x": q.imag.x, "y": q.imag.y, "z": q.imag.z, "w": q.real],
            ],
        ]
    }

    /// The motion from the map (y up) to the session, or nil when not localized.
    func sessionFromMap(service: URL, mapId: String) async throws -> simd_float4x4? {
        let options: [String: Any] = ["frame": "webxr", "cameras": shots.map(\.camera), "session": ["up": "known"]]
        let boundary = UUID().uuidString
        var body = Data()
        func part(_ name: String, _ content: Data) {
            body += Data("--\(boundary)\r\nContent-Disposition: form-data; name=\(name)\r\n\r\n".utf8)
            body += content + Data("\r\n".utf8)
        }
        for (number, shot) in shots.enumerated() { part("\"image\"; filename=\"\(number).jpg\"", shot.jpeg) }
        part("\"map_id\"", Data(mapId.utf8))
        part("\"options\"", try JSONSerialization.data(withJSONObject: options))
        body += Data("--\(boundary)--\r\n".utf8)
        var request = URLRequest(url: service.appendingPathComponent("localize"), timeoutInterval: 90)
        request.httpMethod = "POST"
        request.setValue("multipart/form-data; boundary=\(boundary)", forHTTPHeaderField: "Content-Type")
        let (data, response) = try await URLSession.shared.upload(for: request, from: body)
        guard (response as? HTTPURLResponse)?.statusCode == 200 else {
            let problem = String(decoding: data, as: UTF8.self)
            throw NSError(domain: "panoloc", code: 1, userInfo: [NSLocalizedDescriptionKey: problem])
        }
        let answer = try JSONDecoder().decode(Answer.self, from: data)
        answer.warnings.forEach { print($0) }
        guard answer.status == "localized", let found = answer.map_from_session else { return nil }
        let mapFromSession = simd_float4x4(rows: found.matrix.map { simd_float4($0) })
        return mapFromSession.inverse
    }
}

/// Anchor what lies at (x, y, z) of the scan.
func place(x: Float, y: Float, z: Float, _ sessionFromMap: simd_float4x4, in session: ARSession) {
    var content = matrix_identity_float4x4
    content.columns.3 = simd_float4(x, z, -y, 1)
    session.add(anchor: ARAnchor(name: "content", transform: sessionFromMap * content))
}
