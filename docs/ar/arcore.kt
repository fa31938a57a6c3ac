// Collects frames of an ARCore session, localizes them with panoloc and anchors content: docs/ar.md

class Shot(val jpeg: ByteArray, val camera: Map<String, Any>, val turn: FloatArray)

class PlaceFinder {
    val shots = mutableListOf<Shot>()
    private var last = 0L

    /** Call for every frame that session.update() gives. */
    fun offer(frame: Frame) {
        val camera = frame.camera
        if (shots.size >= 6 || frame.timestamp - last < 1_000_000_000) return
        if (camera.trackingState != TrackingState.TRACKING) return
        val turn = camera.pose.rotationQuaternion
        // New only when turned by 30 degrees from every other: cos(30° / 2) = 0.966.
        if (shots.any { shot -> abs(turn.indices.sumOf { (shot.turn[it] * turn[it]).toDouble() }) > 0.966 }) return
        val jpeg = try { frame.acquireCameraImage().use(::jpegOf) }
            catch (_: NotYetAvailableException) { return }
        shots += Shot(jpeg, entry(camera), turn)
        last = frame.timestamp
    }

    fun entry(camera: Camera): Map<String, Any> {
        val pose = camera.pose
        val (width, height) = camera.imageIntrinsics.imageDimensions
        val (fx, fy) = camera.imageIntrinsics.focalLength
        val (cx, cy) = camera.imageIntrinsics.principalPoint
        return mapOf(
            "model" to "pinhole",
            "width_px" to width, "height_px" to height,
            "fx_px" to fx, "fy_px" to fy, "cx_px" to cx, "cy_px" to cy,
            "session_from_camera" to mapOf(
                "position_m" to mapOf("x" to pose.tx(), "y" to pose.ty(), "z" to pose.tz()),
                "quaternion" to mapOf("x" to pose.qx(), "y" to pose.qy(), "z" to pose.qz(), "w" to pose.qw()),
            ),
        )
    }

    /** The motion from the map (y up) to the session, or null when not localized. Not on the main thread. */
    fun sessionFromMap(service: String, mapId: String): Pose? {
        val options =
            mapOf("frame" to "webxr", "cameras" to shots.map { it.camera }, "session" to mapOf("up" to "known"))
        val form = MultipartBody.Builder().setType(MultipartBody.FORM)
        for ((number, shot) in shots.withIndex())
            form.addFormDataPart("image", "$number.jpg", shot.jpeg.toRequestBody())
        form.addFormDataPart("map_id", mapId).addFormDataPart("options", JSONObject(options).toString())
        val client = OkHttpClient.Builder().readTimeout(90, TimeUnit.SECONDS).build()
        val reply = client.newCall(Request.Builder().url("$service/localize").post(form.build()).build()).execute()
        val answer = JSONObject(reply.use { it.body!!.string() })
        check(reply.code == 200) { answer.getString("detail") }
        val warnings = answer.getJSONArray("warnings")
        for (number in 0 until warnings.length()) Log.w("panoloc", warnings.getString(number))
        if (answer.getString("status") != "localized") return null
        val found = answer.getJSONObject("map_from_session")
        val t = found.getJSONObject("position_m")
        val q = found.getJSONObject("quaternion")
        val mapFromSession = Pose(numbers(t, "x", "y", "z"), numbers(q, "x", "y", "z", "w"))
        return mapFromSession.inverse()
    }
}

fun numbers(of: JSONObject, vararg names: String) = FloatArray(names.size) { of.getDouble(names[it]).toFloat() }

/** Anchor what lies at (x, y, z) of the scan. */
fun place(x: Float, y: Float, z: Float, sessionFromMap: Pose, session: Session): Anchor {
    val content = Pose.makeTranslation(x, z, -y)
    return session.createAnchor(sessionFromMap.compose(content))
}

fun jpegOf(image: Image): ByteArray {
    val (luma, u, v) = image.planes
    // Copied at once: every read of a plane's buffer is a call into native code.
    val (lumaBytes, uBytes, vBytes) = image.planes.map { ByteArray(it.buffer.remaining()).also(it.buffer::get) }
    val nv21 = ByteArray(image.width * image.height * 3 / 2)
    var at = 0
    for (row in 0 until image.height) for (column in 0 until image.width)
        nv21[at++] = lumaBytes[row * luma.rowStride + column * luma.pixelStride]
    for (row in 0 until image.height / 2) for (column in 0 until image.width / 2) {
        nv21[at++] = vBytes[row * v.rowStride + column * v.pixelStride]
        nv21[at++] = uBytes[row * u.rowStride + column * u.pixelStride]
    }
    val jpeg = ByteArrayOutputStream()
    YuvImage(nv21, ImageFormat.NV21, image.width, image.height, null)
        .compressToJpeg(Rect(0, 0, image.width, image.height), 90, jpeg)
    return jpeg.toByteArray()
}
