/** Generated from the OpenAPI document of the service by `scripts/update-docs`: change the models there instead. */

export type paths = Record<string, never>;
export type webhooks = Record<string, never>;
export interface components {
    schemas: {
        /**
         * Accuracy
         * @description Radius that contains the pose with probability `level`.
         */
        Accuracy: {
            /** Position M */
            position_m: number | null;
            /** Orientation Deg */
            orientation_deg: number | null;
            /** Level */
            level: number;
        };
        /**
         * Alternative
         * @description Another possible pose.
         */
        Alternative: {
            pose: components["schemas"]["PoseAnswer"];
            /** Confidence */
            confidence: number;
            /**
             * Map Id
             * @description The map of the pose.
             */
            map_id: string;
        };
        /**
         * AnswerWithChange
         * @description One of the answers in use.
         */
        AnswerWithChange: {
            /**
             * Id
             * @description Id of the localization, whose answer may have expired; null for keys of a tenant, because tenants may share the map.
             */
            id: string | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /**
             * Position M
             * @description Position of the photo.
             */
            position_m: [
                number,
                number,
                number
            ];
            /** Confidence */
            confidence: number;
            /** Panorama Changed Fraction */
            panorama_changed_fraction: number | null;
            /** Map Changed Fraction */
            map_changed_fraction: number | null;
        };
        /**
         * Batch
         * @description Images that are localized one by one; a batch survives restarts of the service.
         */
        Batch: {
            /** Id */
            id: string;
            /** Name */
            name: string;
            /**
             * Status
             * @enum {string}
             */
            status: "queued" | "running" | "done";
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Map Ids */
            map_ids: string[];
            /** Tag */
            tag: string | null;
            /** Num Images */
            num_images: number;
            /** Progress */
            progress: number;
            counts: components["schemas"]["BatchCounts"];
            /**
             * Ignored
             * @description Files of the archive whose names are not those of images; at most 100.
             */
            ignored: string[];
            /**
             * Items
             * @description A page of the images, in their order; empty in the answer to `POST /batches`.
             */
            items: components["schemas"]["BatchItem"][];
            /**
             * Next Cursor
             * @description Send it as `cursor` for the next page; null on the last one.
             */
            next_cursor: string | null;
        };
        /**
         * BatchCounts
         * @description Number of images by status.
         */
        BatchCounts: {
            /** Waiting */
            waiting: number;
            /** Localized */
            localized: number;
            /** Ambiguous */
            ambiguous: number;
            /** Not Localized */
            not_localized: number;
            /** Failed */
            failed: number;
        };
        /**
         * BatchItem
         * @description One image.
         */
        BatchItem: {
            /**
             * Number
             * @description Its place in the upload.
             */
            number: number;
            /** Name */
            name: string;
            /**
             * Status
             * @enum {string}
             */
            status: "waiting" | "localized" | "ambiguous" | "not_localized" | "failed";
            /** @description As from `POST /localize`; null while the image waits, or if it failed. */
            answer: components["schemas"]["Localization"] | null;
            error: components["schemas"]["ProblemDocument"] | null;
        };
        /**
         * BatchOverview
         * @description A batch in a list.
         */
        BatchOverview: {
            /** Id */
            id: string;
            /** Name */
            name: string;
            /**
             * Status
             * @enum {string}
             */
            status: "queued" | "running" | "done";
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** Map Ids */
            map_ids: string[];
            /** Tag */
            tag: string | null;
            /** Num Images */
            num_images: number;
            /** Progress */
            progress: number;
        };
        /**
         * BatchPage
         * @description A page of the caller's batches.
         */
        BatchPage: {
            /** Items */
            items: components["schemas"]["BatchOverview"][];
            /**
             * Next Cursor
             * @description Send it as `cursor` for the next page; null on the last one.
             */
            next_cursor: string | null;
        };
        /**
         * Box
         * @description A box along the axes of the map's own frame, metres.
         */
        Box: {
            /**
             * Min
             * @description x, y, z
             */
            min: [
                number,
                number,
                number
            ];
            /**
             * Max
             * @description x, y, z
             */
            max: [
                number,
                number,
                number
            ];
        };
        /**
         * Change
         * @description Differing share of scan and panorama.
         */
        Change: {
            /** Panorama Changed Fraction */
            panorama_changed_fraction: number | null;
            /** Map Changed Fraction */
            map_changed_fraction: number | null;
        };
        /**
         * ChangedCell
         * @description A cube with a change.
         */
        ChangedCell: {
            /**
             * Center M
             * @description x, y, z
             */
            center_m: [
                number,
                number,
                number
            ];
            /**
             * Num Changed
             * @description Answers that saw a change here.
             */
            num_changed: number;
            /**
             * Num Seen
             * @description Answers that saw this cell at all.
             */
            num_seen: number;
            /**
             * Last Changed At
             * Format: date-time
             */
            last_changed_at: string;
        };
        /**
         * CheckedPoint
         * @description A control point and its residuals.
         */
        CheckedPoint: {
            /** Name */
            name: string;
            /** X */
            x: number | null;
            /** Y */
            y: number | null;
            /** Z */
            z: number | null;
            /** Latitude Deg */
            latitude_deg: number | null;
            /** Longitude Deg */
            longitude_deg: number | null;
            /** Height M */
            height_m: number | null;
            /**
             * Position M
             * @description The point in the map's own frame; null while it is not known.
             */
            position_m: number[] | null;
            /** @description As the map stands; null where it has no place to compare with. */
            as_is: components["schemas"]["Residual"] | null;
            /** @description After the fit. */
            fitted: components["schemas"]["Residual"] | null;
            /**
             * Left Out M
             * @description Distance from where the fit of all other points puts this one.
             */
            left_out_m: number | null;
        };
        /**
         * ControlFit
         * @description The best turn about the vertical and shift of the map.
         */
        ControlFit: {
            /** Num Points */
            num_points: number;
            /** Rms Horizontal M */
            rms_horizontal_m: number;
            /** Rms Up M */
            rms_up_m: number;
            /** Rms M */
            rms_m: number;
            /** Largest M */
            largest_m: number;
            /**
             * Rms Left Out M
             * @description Of each point against the fit of the others: what a point without control can be off by.
             */
            rms_left_out_m: number;
            /**
             * Turn Deg
             * @description Counter-clockwise, from the map to the coordinates.
             */
            turn_deg: number;
            /**
             * Scale
             * @description Distances of the coordinates to those of the map; the fit does not scale.
             */
            scale: number;
            /**
             * Tilt Deg
             * @description Of the fit that also tilts; the fit itself is level.
             */
            tilt_deg: number;
            /** @description For `PATCH /maps/{id}`; null where `no_georeference` says why. */
            georeference: components["schemas"]["Georeference"] | null;
        };
        /**
         * ControlReport
         * @description What control points say of a map.
         */
        ControlReport: {
            /** Map Id */
            map_id: string;
            /** Revision */
            revision: number;
            /**
             * Is On Earth
             * @description False for coordinates without a coordinate system.
             */
            is_on_earth: boolean;
            /**
             * Coordinate System
             * @description As sent with the points.
             */
            coordinate_system: string | null;
            /** Geoid Undulation M */
            geoid_undulation_m: number | null;
            /** Points */
            points: components["schemas"]["CheckedPoint"][];
            as_is: components["schemas"]["ControlSummary"] | null;
            fit: components["schemas"]["ControlFit"] | null;
            /**
             * No Fit
             * @description Why there is no fit, and what to do.
             */
            no_fit: string | null;
            /** No Georeference */
            no_georeference: string | null;
            /**
             * Suspect
             * @description Name of the point that the others show to be wrong; a warning says by how much.
             */
            suspect: string | null;
            /** Warnings */
            warnings: string[];
        };
        /**
         * ControlSummary
         * @description Root mean squares over the points.
         */
        ControlSummary: {
            /** Num Points */
            num_points: number;
            /** Rms Horizontal M */
            rms_horizontal_m: number;
            /** Rms Up M */
            rms_up_m: number;
            /** Rms M */
            rms_m: number;
            /** Largest M */
            largest_m: number;
        };
        /**
         * Coordinates
         * @description A position of a map in the systems that are known of it.
         */
        Coordinates: {
            /** Position M */
            position_m: [
                number,
                number,
                number
            ];
            /** @description In the `coordinate_system` of the map; of a map with a `georeference` in that of its control points; null without one. */
            grid: components["schemas"]["GridPosition"] | null;
            /** @description Null for a map without a place on Earth, and outside of its grid. */
            wgs84: components["schemas"]["EarthPosition"] | null;
        };
        /**
         * Diagnostic
         * @description A remark about a scan.
         */
        Diagnostic: {
            /** Code */
            code: string;
            /**
             * Severity
             * @enum {string}
             */
            severity: "info" | "warning" | "error";
            /** Message */
            message: string;
            /** @description How to end a doubt about unit, heights or up axis. Until then, answers of the map warn of it. */
            question?: components["schemas"]["ReadingQuestion"] | null;
        };
        /**
         * EarthPosition
         * @description A position on WGS 84.
         */
        EarthPosition: {
            /** Latitude Deg */
            latitude_deg: number;
            /** Longitude Deg */
            longitude_deg: number;
            /** Height M */
            height_m: number;
            /**
             * Height Reference
             * @description What `height_m` is above.
             * @enum {string}
             */
            height_reference: "ellipsoid" | "geoid" | "unknown";
        };
        /**
         * FieldMistake
         * @description One wrong field of the options, or one wrong part of the form.
         */
        FieldMistake: {
            /**
             * Field
             * @example hints.radius_m
             */
            field: string;
            /**
             * Message
             * @example Input should be greater than 0, got -1
             */
            message: string;
        };
        /**
         * Floor
         * @description A floor of the scanned building.
         */
        Floor: {
            /**
             * Level M
             * @description Level of the floor in the map's own frame, metres.
             */
            level_m: number;
            /**
             * Height M
             * @description Clear height up to the ceiling, metres; null where none was scanned.
             */
            height_m: number | null;
        };
        /**
         * GeoPose
         * @description OGC GeoPose 1.0, Basic-Quaternion: from camera axes (x forward, y left, z up) to east, north, up.
         */
        GeoPose: {
            position: components["schemas"]["GeoPosition"];
            quaternion: components["schemas"]["Quaternion"];
        };
        /**
         * GeoPosition
         * @description WGS 84.
         */
        GeoPosition: {
            /**
             * Lat
             * @description Degrees.
             */
            lat: number;
            /** Lon */
            lon: number;
            /**
             * H
             * @description Metres above the ellipsoid.
             */
            h: number;
        };
        /**
         * Georeference
         * @description Position of the map's origin on Earth (WGS 84).
         */
        Georeference: {
            /** Latitude Deg */
            latitude_deg: number;
            /** Longitude Deg */
            longitude_deg: number;
            /**
             * Height M
             * @description Above the ellipsoid. Default: 0.0.
             */
            height_m?: number;
            /**
             * Heading Deg
             * @description Compass heading of the map's y axis, clockwise from north. Default: 0.0.
             */
            heading_deg?: number;
        };
        /**
         * GridPosition
         * @description A position on the grid of the map's coordinate system, in the unit of that.
         */
        GridPosition: {
            /** Coordinate System */
            coordinate_system: string;
            /** Name */
            name: string;
            /** East */
            east: number;
            /** North */
            north: number;
            /** Unit */
            unit: string;
            /**
             * Height M
             * @description Height in the system: of a map with a georeference above the geoid, null without `geoid_undulation_m`.
             */
            height_m: number | null;
        };
        /**
         * HandPlacement
         * @description What comes of a pose or of pairs.
         */
        HandPlacement: {
            /** @description The pose as it was sent, or as the pairs say. */
            given: components["schemas"]["PlacedPose"];
            /** @description Refined by the engine, which searches nowhere else; null without `refine`, and where the scan shows nothing. */
            refined: components["schemas"]["PlacedPose"] | null;
            /**
             * Better
             * @description Which of both to take: `given` where the refined pose leaves the clicked points, or the scan hardly supports it.
             * @enum {string}
             */
            better: "given" | "refined";
            /**
             * Moved M
             * @description From the given to the refined position.
             */
            moved_m: number | null;
            /** Moved Deg */
            moved_deg: number | null;
            /** @description The photo as the batch has it now; changed only by `confirm`. */
            item: components["schemas"]["BatchItem"];
        };
        /**
         * Health
         * @description The whole service.
         */
        Health: {
            /**
             * Status
             * @enum {string}
             */
            status: "ready" | "not_ready";
            /**
             * Waiting For
             * @description Missing parts; empty when ready.
             * @example [
             *       "workers"
             *     ]
             */
            waiting_for: string[];
            /** Version */
            version: string;
            /** Uptime S */
            uptime_s: number;
            /**
             * Redis
             * @enum {string}
             */
            redis: "up" | "down";
            /**
             * Storage
             * @enum {string}
             */
            storage: "writable" | "not_writable";
            workers: components["schemas"]["PoolHealth"];
            /**
             * Recent Errors
             * @description Only in `/health`: the last 50, newest first: requests since the process started, and maps that failed.
             */
            recent_errors?: components["schemas"]["RecentError"][];
            /**
             * Maps
             * @description Maps by status.
             * @example {
             *       "queued": 1,
             *       "ready": 3
             *     }
             */
            maps: {
                [key: string]: number;
            };
        };
        /**
         * ImageAnswer
         * @description One image of the query.
         */
        ImageAnswer: {
            /** @description Pose of the image; null if the query is `not_localized`. */
            pose: components["schemas"]["PoseAnswer"] | null;
            /**
             * Agreement
             * @description Correlation of the image with the scan rendered at its pose, -1 to 1; for the best guess if the query is `not_localized`; null if unknown.
             */
            agreement: number | null;
            camera: components["schemas"]["ImageCamera"];
        };
        /**
         * ImageCamera
         * @description The camera that was used for an image.
         */
        ImageCamera: {
            /**
             * Model
             * @enum {string}
             */
            model: "equirectangular" | "pinhole" | "opencv" | "opencv_fisheye" | "cylindrical";
            /**
             * Hfov Deg
             * @description Horizontal field of view; 360: a full panorama, or a full turn.
             */
            hfov_deg: number;
        };
        /**
         * Liveness
         * @description The process runs.
         */
        Liveness: {
            /**
             * Status
             * @description Default: "live".
             * @constant
             */
            status?: "live";
        };
        /** @description The answer to a query. A panorama that fits no pose is `not_localized` with `pose: null`, not an error. */
        Localization: components["schemas"]["Localized"] | components["schemas"]["Ambiguous"] | components["schemas"]["NotLocalized"];
        /**
         * Map
         * @description A registered scan.
         *
         *     After `PUT /maps/{id}/scan`, `revision`, `status`, `stage`, `progress` and `error` describe the new revision. Until
         *     it is ready, `serving_revision` answers queries; `stats` and `diagnostics` belong to that revision.
         */
        Map: {
            /** Id */
            id: string;
            /** Name */
            name: string;
            /** Tags */
            tags: string[];
            /**
             * Revision
             * @description The newest revision of the scan.
             */
            revision: number;
            /**
             * Serving Revision
             * @description The serving revision; null until the first is ready.
             */
            serving_revision: number | null;
            /**
             * Status
             * @enum {string}
             */
            status: "queued" | "reading" | "indexing" | "ready" | "failed";
            /**
             * Stage
             * @description Current step of the registration, for people.
             */
            stage: string | null;
            /** Progress */
            progress: number;
            error: components["schemas"]["ProblemDocument"] | null;
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /**
             * Updated At
             * Format: date-time
             */
            updated_at: string;
            stats: components["schemas"]["MapStats"] | null;
            /** Diagnostics */
            diagnostics: components["schemas"]["Diagnostic"][];
            /** Georeference */
            georeference: {
                [key: string]: unknown;
            } | null;
            /**
             * Coordinate System
             * @description Coordinate system of positions, as an EPSG code or WKT: as given, else from the scan's file; null: none.
             */
            coordinate_system: string | null;
            /**
             * Geoid Undulation M
             * @description Height of the geoid above the ellipsoid at the map, metres, as given.
             */
            geoid_undulation_m?: number | null;
            /**
             * Owner
             * @description Tenant of the key that created the map; null: none.
             */
            owner?: string | null;
            /**
             * Shared With
             * @description Other tenants that can view the map; `*` for all.
             */
            shared_with?: string[];
            /**
             * Version
             * @description Increases with each change; a change with `If-Match` requires this version. Default: 0.
             */
            version?: number;
        };
        /**
         * MapChanges
         * @description Changes since the scan, from the answers of the last `lifetime_s` seconds, or of the period that was asked for.
         */
        MapChanges: {
            /** Map Id */
            map_id: string;
            /**
             * Revision
             * @description Serving revision of the scan; answers from other revisions do not count.
             */
            revision: number;
            /**
             * Lifetime S
             * @description Seconds for which an answer counts.
             */
            lifetime_s: number;
            /**
             * Cell M
             * @description Edge length of a cell in metres; null without answers.
             */
            cell_m: number | null;
            /**
             * Answers
             * @description Newest first.
             */
            answers: components["schemas"]["AnswerWithChange"][];
            /**
             * Num Photos
             * @description Small photos that are kept, in which objects are looked for: of batches, and of other queries where the operator keeps images.
             */
            num_photos: number;
            /**
             * Objects
             * @description The surest first. Empty without kept photos.
             */
            objects: components["schemas"]["ObjectChange"][];
            /**
             * Cells
             * @description Cells, those with the most changes first.
             */
            cells: components["schemas"]["ChangedCell"][];
        };
        /**
         * MapLink
         * @description A link that opens a map on a phone.
         */
        MapLink: {
            /**
             * Url
             * @description Page of the map. What follows `#` never leaves the phone.
             */
            url: string;
            /**
             * Key Id
             * @description Id of the key in the link, which can localize in this map and read it; null: the service requires none.
             */
            key_id: string | null;
            /**
             * Qr Svg
             * @description QR code of the link, SVG.
             */
            qr_svg: string;
        };
        /**
         * MapPage
         * @description A page of maps, oldest first.
         */
        MapPage: {
            /** Items */
            items: components["schemas"]["Map"][];
            /**
             * Next Cursor
             * @description Send it as `cursor` for the next page; null on the last one.
             */
            next_cursor: string | null;
        };
        /**
         * MapStarts
         * @description All starts of a map, in its own frame.
         */
        MapStarts: {
            /** Map Id */
            map_id: string;
            /** Revision */
            revision: number;
            /** Num Starts */
            num_starts: number;
            /** Starts */
            starts: components["schemas"]["Start"][];
        };
        /**
         * MapStats
         * @description Figures of a finished registration.
         */
        MapStats: {
            /**
             * Num Points
             * @description Points in the scan.
             */
            num_points: number;
            /**
             * Num Points Used
             * @description Points that remain after thinning.
             */
            num_points_used: number;
            bounds: components["schemas"]["Box"];
            /**
             * Origin Offset
             * @description x, y, z
             */
            origin_offset: [
                number,
                number,
                number
            ];
            /** Num Starts */
            num_starts: number;
            /** Index Bytes */
            index_bytes: number;
            /**
             * Seconds
             * @description Duration of each stage.
             */
            seconds: {
                [key: string]: number;
            };
            /**
             * Coordinate System
             * @description Of the scan's coordinates, if its file names one.
             */
            coordinate_system?: string | null;
            /** @description Unit and axes of the scan; null for maps of earlier versions. */
            read_as?: components["schemas"]["ReadAs"] | null;
            /**
             * Floors
             * @description Floors that were found in the scan, bottom up.
             */
            floors?: components["schemas"]["Floor"][];
        };
        /**
         * ObjectChange
         * @description An object that came, went or moved. Positions are in the map's own frame, in metres.
         */
        ObjectChange: {
            /**
             * Id
             * @description 12 hex digits, made of kind and place.
             */
            id: string;
            /**
             * Kind
             * @enum {string}
             */
            kind: "came" | "went" | "moved";
            /**
             * Center M
             * @description Middle of its box; of what went, where it was.
             */
            center_m: [
                number,
                number,
                number
            ];
            /**
             * Size M
             * @description Edges of its box along the map's axes.
             */
            size_m: [
                number,
                number,
                number
            ];
            /**
             * From M
             * @description Where it was before; null unless it moved.
             */
            from_m: [
                number,
                number,
                number
            ] | null;
            /**
             * Floor
             * @description Floor that it stands on, 0 for the lowest of `stats.floors`; null if none is known.
             */
            floor: number | null;
            /**
             * Certainty
             * @description How probable it is that this object changed. More photos and stronger contrast make it surer.
             */
            certainty: number;
            /**
             * Is Sure
             * @description False where the certainty is too low to state the change: look at the picture, or leave it out.
             */
            is_sure: boolean;
            /**
             * Num Photos
             * @description Photos that saw the change. With one, its place is a guess along the line of sight.
             */
            num_photos: number;
            /**
             * Seen From M
             * @description Position of the photo that shows it best.
             */
            seen_from_m: [
                number,
                number,
                number
            ];
            /**
             * First Seen At
             * Format: date-time
             */
            first_seen_at: string;
            /**
             * Last Seen At
             * Format: date-time
             */
            last_seen_at: string;
        };
        /**
         * OpenFlameAnswer
         * @description A response of an OpenFLAME map server.
         */
        OpenFlameAnswer: {
            /** Success */
            success: boolean;
            /**
             * Pose
             * @description 4 x 4, row by row: from the camera (x right, y up, z backward) to the world of A-Frame (y, z, x of the map).
             */
            pose: number[][] | null;
            /** Confidence */
            confidence: number;
        };
        /**
         * OpenFlameCapabilities
         * @description Capabilities of an OpenFLAME map server.
         */
        OpenFlameCapabilities: {
            /** Commonname */
            commonName: string;
            /** Iconurl */
            iconURL: string;
            /** Services */
            services: {
                [key: string]: unknown;
            }[];
        };
        /**
         * PendingLocalization
         * @description A query with `Prefer: respond-async` that has no answer yet, or has failed.
         */
        PendingLocalization: {
            /** Id */
            id: string;
            /**
             * Status
             * @enum {string}
             */
            status: "queued" | "running" | "failed";
            /**
             * Created At
             * Format: date-time
             */
            created_at: string;
            /** @description Reason of a failure; null otherwise. */
            error: components["schemas"]["ProblemDocument"] | null;
        };
        /**
         * PlacedPose
         * @description A pose, and what speaks for it.
         */
        PlacedPose: {
            pose: components["schemas"]["PoseAnswer"];
            /** @description Camera of the photo at this pose: the refined pose may have another field of view than the photo states. */
            camera: components["schemas"]["ImageCamera"];
            /**
             * Residuals Px
             * @description Of each pair: pixels between where the point was clicked and where this pose shows it; null without pairs.
             */
            residuals_px: number[] | null;
            /** Rms Px */
            rms_px: number | null;
            /**
             * Agreement
             * @description Correlation of the photo with the scan rendered at the pose, -1 to 1; null if unknown.
             */
            agreement: number | null;
            /**
             * Confidence
             * @description As in an answer; of pairs by their geometry, lowered where the engine doubts them; 0 if nothing measures it.
             */
            confidence: number;
            accuracy: components["schemas"]["Accuracy"] | null;
            /** Warnings */
            warnings: string[];
        };
        /**
         * PoolHealth
         * @description The workers.
         */
        PoolHealth: {
            /** Ready */
            ready: boolean;
            /** Waiting For */
            waiting_for: string | null;
            /** Num Workers */
            num_workers: number;
            /**
             * Queue Depth
             * @description Queries waiting for a worker.
             */
            queue_depth: number;
            /**
             * Resident Bytes
             * @description Map indexes in the workers' memory.
             */
            resident_bytes: number;
        };
        /**
         * PoseAnswer
         * @description Position and orientation of the camera: as rotations about its axes, and as heading, elevation and roll.
         */
        PoseAnswer: {
            /**
             * Frame
             * @enum {string}
             */
            frame: "ros" | "opencv" | "webxr" | "unity";
            map_from_camera: components["schemas"]["RigidMotion"];
            /**
             * Yaw Deg
             * @description Counter-clockwise about z from the map's x axis, -180 to 180.
             */
            yaw_deg: number;
            /**
             * Pitch Deg
             * @description Positive if the camera looks down.
             */
            pitch_deg: number;
            /** Roll Deg */
            roll_deg: number;
            /**
             * Heading Deg
             * @description Of the image centre, clockwise from `north`, 0 to 360.
             */
            heading_deg: number;
            /**
             * Elevation Deg
             * @description Of the image centre, positive above the horizon.
             */
            elevation_deg: number;
            /**
             * Camera Roll Deg
             * @description Positive if the camera's right side is down.
             */
            camera_roll_deg: number;
            /**
             * North
             * @description Zero direction of `heading_deg`: the map's y axis, or true north if the map has a georeference.
             * @enum {string}
             */
            north: "map" | "true";
        };
        /**
         * Position
         * @description Metres, in the map's own frame.
         */
        Position: {
            /** X */
            x: number;
            /** Y */
            y: number;
            /** Z */
            z: number;
        };
        /**
         * ProblemDocument
         * @description A problem document (RFC 9457).
         */
        ProblemDocument: {
            /**
             * Type
             * @description Stable URI of the kind of problem, relative to the service.
             */
            type: string;
            /**
             * Title
             * @description The kind of problem, for people.
             */
            title: string;
            /** Status */
            status: number;
            /**
             * Detail
             * @description What was expected, what came and what to do.
             */
            detail: string;
            /**
             * Request Id
             * @description The service's log has details under this id.
             */
            request_id: string;
            /**
             * Fields
             * @description Wrong fields of the options, or the faulty upload, `image` or `mask`.
             */
            fields?: components["schemas"]["FieldMistake"][] | null;
        };
        /**
         * Quaternion
         * @description A unit quaternion.
         */
        Quaternion: {
            /** X */
            x: number;
            /** Y */
            y: number;
            /** Z */
            z: number;
            /** W */
            w: number;
        };
        /**
         * ReadAs
         * @description How the coordinates of a scan were read, and who says so: the caller, the file, or what was scanned.
         */
        ReadAs: {
            /**
             * Unit
             * @description Null: a unit that has no name here.
             */
            unit: ("m" | "cm" | "mm" | "ft" | "us-ft") | null;
            /** Height Unit */
            height_unit: ("m" | "cm" | "mm" | "ft" | "us-ft") | null;
            /**
             * Up Axis
             * @enum {string}
             */
            up_axis: "z" | "y" | "x" | "-z" | "-y" | "-x";
            /**
             * Unit From
             * @enum {string}
             */
            unit_from: "given" | "file" | "judged" | "assumed";
            /**
             * Height Unit From
             * @enum {string}
             */
            height_unit_from: "given" | "file" | "judged" | "assumed";
            /**
             * Up Axis From
             * @enum {string}
             */
            up_axis_from: "given" | "file" | "judged" | "assumed";
        };
        /**
         * Readiness
         * @description Readiness, for probes without a key.
         */
        Readiness: {
            /**
             * Status
             * @enum {string}
             */
            status: "ready" | "not_ready";
        };
        /**
         * ReadingChoice
         * @description An answer to a question about a scan.
         */
        ReadingChoice: {
            /** Label */
            label: string;
            /**
             * Patch
             * @description The body for `PATCH /maps/{id}` that gives this answer.
             */
            patch: {
                [key: string]: string;
            };
            /**
             * Storey Height M
             * @description Between floor and ceiling, read in this way.
             */
            storey_height_m: number | null;
            /**
             * Extent M
             * @description Of the scan along x, y and z, read in this way.
             */
            extent_m: number[];
        };
        /**
         * ReadingQuestion
         * @description What the file and the scanned building leave open.
         */
        ReadingQuestion: {
            /** Text */
            text: string;
            /** Choices */
            choices: components["schemas"]["ReadingChoice"][];
        };
        /**
         * RecentError
         * @description A request or a registration that ended in a problem.
         */
        RecentError: {
            /**
             * At
             * Format: date-time
             */
            at: string;
            /** Method */
            method: string;
            /** Path */
            path: string;
            /** Type */
            type: string | null;
            /** Title */
            title: string | null;
            /** Status */
            status: number | null;
            /** Detail */
            detail: string | null;
            /**
             * Request Id
             * @description As in the log.
             */
            request_id: string | null;
        };
        /**
         * Residual
         * @description Place in the map minus known coordinates, metres: true east, true north and up; without a place on Earth along x, y, z.
         */
        Residual: {
            /** East M */
            east_m: number;
            /** North M */
            north_m: number;
            /** Up M */
            up_m: number;
            /** Horizontal M */
            horizontal_m: number;
            /** Distance M */
            distance_m: number;
        };
        /**
         * RigidMotion
         * @description x_to = rotation · x_from + position: `map_from_camera` or `map_from_session`.
         */
        RigidMotion: {
            position_m: components["schemas"]["Position"];
            quaternion: components["schemas"]["Quaternion"];
            /**
             * Matrix
             * @description 4 x 4, row by row.
             */
            matrix: number[][];
        };
        /**
         * Start
         * @description A start position of the search.
         */
        Start: {
            /**
             * Position M
             * @description x, y, z
             */
            position_m: [
                number,
                number,
                number
            ];
            /**
             * Leaf Size M
             * @description Edge length of the octree leaf, or of the grid cell, around it.
             */
            leaf_size_m: number;
        };
        /**
         * BatchHints
         * @description Hints for each image of a batch.
         */
        BatchHints: {
            /**
             * Position M
             * @description Camera position in the map's own frame.
             */
            position_m?: [
                number,
                number,
                number
            ] | null;
            /**
             * Radius M
             * @description Largest distance from `position_m`; 5 by default.
             */
            radius_m?: number | null;
            /** @description Box around the camera in the map's own frame. */
            region?: components["schemas"]["Box"] | null;
            /**
             * Upright
             * @description The camera is level within `max_tilt_deg`.
             */
            upright?: boolean | null;
            /**
             * Max Tilt Deg
             * @description 45 when only `upright` is given.
             */
            max_tilt_deg?: number | null;
            /**
             * Heading Deg
             * @description Yaw of the image centre, counter-clockwise about z from +x: the `yaw_deg` of an answer, not its `heading_deg`.
             */
            heading_deg?: number | null;
            /**
             * Heading Tolerance Deg
             * @description 45 by default.
             */
            heading_tolerance_deg?: number | null;
            /**
             * Prior
             * @description Not in a batch: each image was taken elsewhere.
             */
            prior?: null;
        };
        /**
         * BatchOptions
         * @description The part `options` of `POST /batches`: as for `POST /localize`, but without pictures and sessions.
         *
         *     Also the name of the batch, and answers that its images already have.
         */
        BatchOptions: {
            /**
             * Frame
             * @description Axes of the answer; see docs/api.md. Default: "ros".
             * @enum {string}
             */
            frame?: "ros" | "opencv" | "webxr" | "unity";
            /**
             * Method
             * @description `paper`: the recipe of the paper, slower. Default: "fast".
             * @enum {string}
             */
            method?: "fast" | "paper";
            hints?: components["schemas"]["BatchHints"] | null;
            /**
             * Cameras
             * @description Camera of all images, one entry. Without it, the camera comes from the metadata of each image.
             */
            cameras?: components["schemas"]["Camera"][] | null;
            /**
             * Session
             * @description Not in a batch: each image is a separate query; send sessions to `POST /localize`.
             */
            session?: null;
            /**
             * Artifacts
             * @description Not in a batch: a batch stores no pictures.
             */
            artifacts?: unknown[];
            /**
             * Top K
             * @description Largest number of poses: the pose and up to `top_k` − 1 alternatives; `ambiguous` always lists its rivals. Default: 1.
             */
            top_k?: number;
            /**
             * Timeout S
             * @description Seconds for the answer, then 504; null: the service's default, which is longer for `paper`.
             */
            timeout_s?: number | null;
            /**
             * Name
             * @description For people; default: the name of the archive or of the images' folder, else the time.
             */
            name?: string | null;
            /**
             * Answers
             * @description Ids of answers to `POST /localize` that the parts `image` already have, in their order; null where there is none. Answers that the service still has are kept; the other images are localized.
             */
            answers?: (string | null)[] | null;
        };
        /**
         * BatchPatch
         * @description The body of `PATCH /batches/{id}`.
         */
        BatchPatch: {
            /** Name */
            name: string;
        };
        /**
         * Camera
         * @description Intrinsics of an image of `width_px` x `height_px`, or a field of view.
         *
         *     The upload may be a resized copy of that image.
         *
         *     Pixel centres are half-integers: the centre of the top-left pixel is (0.5, 0.5).
         */
        Camera: {
            /**
             * Model
             * @description `pinhole`; `opencv` and `opencv_fisheye` with OpenCV's distortion; `cylindrical` for the sweep panoramas of phones; `equirectangular`, also a part of the sphere. With `session_from_camera` alone, the camera comes from the image's metadata.
             */
            model?: ("equirectangular" | "pinhole" | "opencv" | "opencv_fisheye" | "cylindrical") | null;
            /**
             * Width Px
             * @description Width of the image to which the intrinsics belong.
             */
            width_px?: number | null;
            /** Height Px */
            height_px?: number | null;
            /**
             * Fx Px
             * @description Focal length; for `cylindrical` and `equirectangular` horizontal pixels per radian.
             */
            fx_px?: number | null;
            /**
             * Fy Px
             * @description Default: `fx_px`.
             */
            fy_px?: number | null;
            /**
             * Cx Px
             * @description Default: the middle.
             */
            cx_px?: number | null;
            /**
             * Cy Px
             * @description Default: the middle.
             */
            cy_px?: number | null;
            /**
             * Distortion
             * @description `k1 k2 p1 p2 [k3 [k4 k5 k6]]`, or `k1 k2 k3 k4` of the fisheye.
             */
            distortion?: number[];
            /**
             * Hfov Deg
             * @description Horizontal field of view, instead of `fx_px` … `cy_px`.
             */
            hfov_deg?: number | null;
            /**
             * Hfov Range Deg
             * @description Bounds of an unknown field of view of `pinhole` photos, such as `[45, 85]`, the same for all images. The search takes several times as long; `images[…].camera` in the answer has the result.
             */
            hfov_range_deg?: [
                number,
                number
            ] | null;
            /**
             * Unless Panorama
             * @description Images that are twice as wide as high, or have GPano fields, are read as panoramas; the entry is for the others. Default: false.
             */
            unless_panorama?: boolean;
            /** @description Tracked pose of the image; needed for each of several images. */
            session_from_camera?: components["schemas"]["SessionFromCamera"] | null;
        };
        /**
         * CameraMotion
         * @description x_then = rotation · x_now + position: the pose of the camera now in that of the camera then, both in the camera axes of `frame`.
         */
        CameraMotion: {
            position_m: components["schemas"]["SessionPosition"];
            quaternion: components["schemas"]["SessionQuaternion"];
        };
        /**
         * CameraParameters
         * @description Intrinsics by COLMAP's names.
         */
        CameraParameters: {
            /**
             * Model
             * @description Such as PINHOLE, OPENCV or EQUIRECTANGULAR.
             */
            model?: string | null;
            /** Modelparams */
            modelParams?: number[] | null;
        } & {
            [key: string]: unknown;
        };
        /**
         * CameraReading
         * @description One image.
         */
        CameraReading: {
            /**
             * Imagebytes
             * @description A JPEG, PNG, WebP, HEIC or AVIF file as base64.
             */
            imageBytes: string;
            /**
             * Imageformat
             * @description `DEPTH`: the image is ignored.
             */
            imageFormat?: string | null;
            /**
             * Size
             * @description Width and height of `params`.
             */
            size?: number[] | null;
            imageOrientation?: components["schemas"]["ImageOrientation"] | null;
            params?: components["schemas"]["CameraParameters"] | null;
        } & {
            [key: string]: unknown;
        };
        /**
         * ClickedPair
         * @description A point of the scan, and where the photo shows it.
         */
        ClickedPair: {
            /**
             * Pixel
             * @description Pixels to the right and down from the top left corner of the photo as it is seen (EXIF orientation applied), in its full size.
             */
            pixel: [
                number,
                number
            ];
            /**
             * Position M
             * @description The point in the map's own frame.
             */
            position_m: [
                number,
                number,
                number
            ];
        };
        /**
         * ControlBody
         * @description The body of `PUT /maps/{id}/control-points`: all points of the map, in place of the former ones.
         */
        ControlBody: {
            /** Points */
            points?: components["schemas"]["SentPoint"][] | null;
            /**
             * Csv
             * @description Instead of `points`: the text of a CSV with the columns name, x, y, z or name, lat, lon, height; and map_x, map_y, map_z where the places in the scan are known. Other usual headings, delimiters and decimal commas are understood.
             */
            csv?: string | null;
            /**
             * Coordinate System
             * @description Of x and y, by EPSG code or WKT; null: that of the map, or none.
             */
            coordinate_system?: string | null;
            /**
             * Geoid Undulation M
             * @description Height of the geoid above the ellipsoid; null: that of the map.
             */
            geoid_undulation_m?: number | null;
        };
        /**
         * ExpectedMotion
         * @description x_map = rotation · x_camera + position, in the axes of `frame`. Other fields of an answer are ignored.
         */
        ExpectedMotion: {
            position_m: components["schemas"]["SessionPosition"];
            quaternion: components["schemas"]["SessionQuaternion"];
        } & {
            [key: string]: unknown;
        };
        /**
         * ExpectedPose
         * @description A pose in the form of an answer, such as its `pose`. Other fields of an answer are ignored.
         */
        ExpectedPose: {
            /**
             * Frame
             * @enum {string}
             */
            frame: "ros" | "opencv" | "webxr" | "unity";
            map_from_camera: components["schemas"]["ExpectedMotion"];
        } & {
            [key: string]: unknown;
        };
        /**
         * GeoPoseAccuracy
         * @description Radii that hold 68 %.
         */
        GeoPoseAccuracy: {
            /**
             * Position
             * @description Metres.
             */
            position: number;
            /**
             * Orientation
             * @description Degrees.
             */
            orientation: number;
        };
        /**
         * GeoPoseReply
         * @description A response of the GeoPoseProtocol.
         */
        GeoPoseReply: {
            /** Id */
            id: string;
            /**
             * Timestamp
             * @description Milliseconds since 1970.
             */
            timestamp: number;
            /**
             * Type
             * @constant
             */
            type: "geopose";
            accuracy: components["schemas"]["GeoPoseAccuracy"];
            geopose: components["schemas"]["GeoPose"];
        };
        /**
         * GeoPoseRequest
         * @description A request of the GeoPoseProtocol of OSCP, version 2.
         */
        GeoPoseRequest: {
            /** Id */
            id?: string | null;
            /** Type */
            type?: string | null;
            sensorReadings: components["schemas"]["SensorReadings"];
        } & {
            [key: string]: unknown;
        };
        /**
         * GeolocationReading
         * @description Position that the device reports.
         */
        GeolocationReading: {
            /** Latitude */
            latitude?: number | null;
            /** Longitude */
            longitude?: number | null;
            /**
             * Accuracy
             * @description Metres.
             */
            accuracy?: number | null;
        } & {
            [key: string]: unknown;
        };
        /**
         * HandPose
         * @description The body of `POST /batches/{id}/images/{number}/pose`: a rough pose, or pairs of clicked points.
         */
        HandPose: {
            /**
             * Map Id
             * @description Map of the pose; needed only where the batch has searched several.
             */
            map_id?: string | null;
            /** @description A rough pose. */
            pose?: components["schemas"]["ExpectedPose"] | null;
            /**
             * Position Std M
             * @description Of `pose`: how far off it may be, as standard deviation of each coordinate. Default: 0.5.
             */
            position_std_m?: number;
            /**
             * Orientation Std Deg
             * @description Of `pose`: standard deviation of the rotation about each axis. Default: 20.0.
             */
            orientation_std_deg?: number;
            /**
             * Pairs
             * @description Instead of `pose`: points clicked in photo and scan. Four or more show mistakes.
             */
            pairs?: components["schemas"]["ClickedPair"][] | null;
            /**
             * Refine
             * @description Refine the pose on photo and scan; false: it stays as it is set, or as the pairs say. Default: true.
             */
            refine?: boolean;
            /**
             * Confirm
             * @description Store the result: true, the pose that `better` names; or the given or the refined one. Otherwise nothing is stored. Default: false.
             */
            confirm?: boolean | ("given" | "refined");
        };
        /**
         * Hints
         * @description Prior knowledge of the caller. Every hint but `prior` narrows the search, and every answer satisfies it.
         */
        Hints: {
            /**
             * Position M
             * @description Camera position in the map's own frame.
             */
            position_m?: [
                number,
                number,
                number
            ] | null;
            /**
             * Radius M
             * @description Largest distance from `position_m`; 5 by default.
             */
            radius_m?: number | null;
            /** @description Box around the camera in the map's own frame. */
            region?: components["schemas"]["Box"] | null;
            /**
             * Upright
             * @description The camera is level within `max_tilt_deg`.
             */
            upright?: boolean | null;
            /**
             * Max Tilt Deg
             * @description 45 when only `upright` is given.
             */
            max_tilt_deg?: number | null;
            /**
             * Heading Deg
             * @description Yaw of the image centre, counter-clockwise about z from +x: the `yaw_deg` of an answer, not its `heading_deg`.
             */
            heading_deg?: number | null;
            /**
             * Heading Tolerance Deg
             * @description 45 by default.
             */
            heading_tolerance_deg?: number | null;
            /** @description A pose that is tried first, in a query of one map. It narrows nothing and may be wrong: where no answer is sure there, everything is searched, unless it is said to be the `only` one. */
            prior?: components["schemas"]["Prior"] | null;
        };
        /**
         * ImageOrientation
         * @description How to turn an image upright.
         */
        ImageOrientation: {
            /**
             * Mirrored
             * @description Default: false.
             */
            mirrored?: boolean;
            /**
             * Rotation
             * @description Default: 0.0.
             */
            rotation?: number;
        } & {
            [key: string]: unknown;
        };
        /**
         * LinkRequest
         * @description The body of `POST /maps/{id}/links`.
         */
        LinkRequest: {
            /**
             * Service Url
             * Format: uri
             * @description Address under which phones reach the service, without query or credentials.
             */
            service_url: string;
        };
        /**
         * LocalizeOptions
         * @description The part `options` of `POST /localize`.
         */
        LocalizeOptions: {
            /**
             * Frame
             * @description Axes of the answer; see docs/api.md. Default: "ros".
             * @enum {string}
             */
            frame?: "ros" | "opencv" | "webxr" | "unity";
            /**
             * Method
             * @description `paper`: the recipe of the paper, slower. Default: "fast".
             * @enum {string}
             */
            method?: "fast" | "paper";
            hints?: components["schemas"]["Hints"] | null;
            /**
             * Cameras
             * @description Cameras of the images: one entry for all, or one per image in their order. Without it, a 2:1 image is a full sphere; for other images the camera comes from GPano fields or the EXIF focal length in 35 mm terms. Several images need one entry each, with `session_from_camera`.
             */
            cameras?: components["schemas"]["Camera"][] | null;
            /** @description Accuracy and up axis of `session_from_camera`. */
            session?: components["schemas"]["TrackedSession"] | null;
            /**
             * Artifacts
             * @description Pictures to draw.
             */
            artifacts?: ("score_map_2d" | "score_map_3d" | "overlay")[];
            /**
             * Top K
             * @description Largest number of poses: the pose and up to `top_k` − 1 alternatives; `ambiguous` always lists its rivals. Default: 1.
             */
            top_k?: number;
            /**
             * Timeout S
             * @description Seconds for the answer, then 504; null: the service's default, which is longer for `paper`.
             */
            timeout_s?: number | null;
        };
        /**
         * MapOptions
         * @description The part `options` of `POST /maps`.
         */
        MapOptions: {
            georeference?: components["schemas"]["Georeference"] | null;
            /**
             * Coordinate System
             * @description Projected coordinate system of the map's positions, by EPSG code such as `EPSG:25832` or by WKT; null: from the scan's file.
             */
            coordinate_system?: string | null;
            /**
             * Geoid Undulation M
             * @description Height of the geoid above the ellipsoid at the map, metres. Needed for a GeoPose if the heights of the `coordinate_system` are above the geoid, or if their reference is unknown.
             */
            geoid_undulation_m?: number | null;
            /**
             * Unit
             * @description Unit of the scan's coordinates. Default: "auto".
             * @enum {string}
             */
            unit?: "m" | "cm" | "mm" | "ft" | "us-ft" | "auto";
            /**
             * Height Unit
             * @description Unit of the heights, where it is another one. Default: "auto".
             * @enum {string}
             */
            height_unit?: "m" | "cm" | "mm" | "ft" | "us-ft" | "auto";
            /**
             * Up Axis
             * @description Axis of the scan that points up. Default: "auto".
             * @enum {string}
             */
            up_axis?: "z" | "y" | "x" | "-z" | "-y" | "-x" | "auto";
            /**
             * Color Kind
             * @description `labels`: colours encode semantic classes. Default: "rgb".
             * @enum {string}
             */
            color_kind?: "rgb" | "labels";
            starts?: components["schemas"]["StartsOptions"];
            /**
             * Name
             * @description Display name; default: the file's name.
             */
            name?: string | null;
            /**
             * Tags
             * @description A query can name a tag instead of maps.
             */
            tags?: string[];
        };
        /**
         * MapPatch
         * @description The body of `PATCH /maps/{id}`: fields left out stay unchanged; null removes a place on Earth.
         *
         *     With another unit or up axis the stored scan is registered again.
         */
        MapPatch: {
            georeference?: components["schemas"]["Georeference"] | null;
            /**
             * Coordinate System
             * @description Projected coordinate system of the map's positions, by EPSG code such as `EPSG:25832` or by WKT; null: from the scan's file.
             */
            coordinate_system?: string | null;
            /**
             * Geoid Undulation M
             * @description Height of the geoid above the ellipsoid at the map, metres. Needed for a GeoPose if the heights of the `coordinate_system` are above the geoid, or if their reference is unknown.
             */
            geoid_undulation_m?: number | null;
            /**
             * Unit
             * @description Unit of the scan's coordinates. Default: "auto".
             * @enum {string}
             */
            unit?: "m" | "cm" | "mm" | "ft" | "us-ft" | "auto";
            /**
             * Height Unit
             * @description Unit of the heights, where it is another one. Default: "auto".
             * @enum {string}
             */
            height_unit?: "m" | "cm" | "mm" | "ft" | "us-ft" | "auto";
            /**
             * Up Axis
             * @description Axis of the scan that points up. Default: "auto".
             * @enum {string}
             */
            up_axis?: "z" | "y" | "x" | "-z" | "-y" | "-x" | "auto";
            /** Name */
            name?: string;
            /** Tags */
            tags?: string[];
            /**
             * Shared With
             * @description Other tenants that can view the map and localize in it; `*` for all.
             */
            shared_with?: string[];
        };
        /**
         * Prior
         * @description Where the first camera is expected: by its pose, or by an earlier answer and the motion since.
         */
        Prior: {
            /** @description The expected pose. */
            pose?: components["schemas"]["ExpectedPose"] | null;
            /**
             * Localization Id
             * @description Instead of `pose`: an earlier answer, `localized` in the same map and the same `frame`. Without `motion` the camera is where it was; or, if both queries have `session_from_camera`, where `map_from_session` of the answer puts it.
             */
            localization_id?: string | null;
            /** @description Of the first camera since that answer: from the first image of its query to the first image of this one. */
            motion?: components["schemas"]["CameraMotion"] | null;
            /**
             * Position Std M
             * @description Standard deviation of each coordinate; 0.3 by default. After a known motion: `accuracy` of the answer and a hundredth of the way.
             */
            position_std_m?: number | null;
            /**
             * Orientation Std Deg
             * @description Standard deviation of the rotation about each axis; 5 by default. After a known motion: `accuracy` of the answer and 0.1 degrees per metre of the way.
             */
            orientation_std_deg?: number | null;
            /**
             * Only
             * @description Nothing is searched elsewhere: the answer is what fits best there, or, where that does not fit well enough, its first alternative. Default: false.
             */
            only?: boolean;
        };
        /**
         * ScanOptions
         * @description How to read a scan and what to build from it.
         */
        ScanOptions: {
            /**
             * Unit
             * @description Unit of the scan's coordinates. Default: "auto".
             * @enum {string}
             */
            unit?: "m" | "cm" | "mm" | "ft" | "us-ft" | "auto";
            /**
             * Height Unit
             * @description Unit of the heights, where it is another one. Default: "auto".
             * @enum {string}
             */
            height_unit?: "m" | "cm" | "mm" | "ft" | "us-ft" | "auto";
            /**
             * Up Axis
             * @description Axis of the scan that points up. Default: "auto".
             * @enum {string}
             */
            up_axis?: "z" | "y" | "x" | "-z" | "-y" | "-x" | "auto";
            /**
             * Color Kind
             * @description `labels`: colours encode semantic classes. Default: "rgb".
             * @enum {string}
             */
            color_kind?: "rgb" | "labels";
            starts?: components["schemas"]["StartsOptions"];
        };
        /**
         * SensorReadings
         * @description Readings of the device's sensors.
         */
        SensorReadings: {
            /** Camerareadings */
            cameraReadings: components["schemas"]["CameraReading"][];
            /** Geolocationreadings */
            geolocationReadings?: components["schemas"]["GeolocationReading"][] | null;
        } & {
            [key: string]: unknown;
        };
        /**
         * SentPoint
         * @description A point whose coordinates are known: x, y, z, or latitude, longitude and height.
         */
        SentPoint: {
            /** Name */
            name: string;
            /**
             * X
             * @description East, metres, in the `coordinate_system`; without one, of a site or of the map itself.
             */
            x?: number | null;
            /**
             * Y
             * @description North.
             */
            y?: number | null;
            /**
             * Z
             * @description Height.
             */
            z?: number | null;
            /**
             * Latitude Deg
             * @description WGS 84.
             */
            latitude_deg?: number | null;
            /** Longitude Deg */
            longitude_deg?: number | null;
            /**
             * Height M
             * @description Above the ellipsoid.
             */
            height_m?: number | null;
            /**
             * Position M
             * @description The point in the map's own frame, as clicked in the scan; null: as stored for this name, or not known yet.
             */
            position_m?: [
                number,
                number,
                number
            ] | null;
        };
        /**
         * SessionFromCamera
         * @description x_session = rotation · x_camera + position, from the device's own tracking, in the axes of `frame`.
         */
        SessionFromCamera: {
            position_m: components["schemas"]["SessionPosition"];
            quaternion: components["schemas"]["SessionQuaternion"];
        };
        /**
         * SessionPosition
         * @description Metres, in the session.
         */
        SessionPosition: {
            /** X */
            x: number;
            /** Y */
            y: number;
            /** Z */
            z: number;
        };
        /**
         * SessionQuaternion
         * @description A unit quaternion.
         */
        SessionQuaternion: {
            /** X */
            x: number;
            /** Y */
            y: number;
            /** Z */
            z: number;
            /** W */
            w: number;
        };
        /**
         * StartsOptions
         * @description Start positions of the search.
         */
        StartsOptions: {
            /**
             * Method
             * @description `octree` for rooms, `grid` for open spaces. Default: "octree".
             * @enum {string}
             */
            method?: "octree" | "grid";
            /**
             * Spacing M
             * @description Distance between starts; null: the service chooses.
             */
            spacing_m?: number | null;
            /** @description Possible camera positions; null: the whole scanned space. */
            region?: components["schemas"]["Box"] | null;
        };
        /**
         * TrackedSession
         * @description Accuracy and up axis of the tracked poses.
         */
        TrackedSession: {
            /**
             * Up
             * @description `known`: the session's up axis (y in `webxr` and `unity`, z in `ros` and `opencv`) is opposite to gravity, as in ARKit, ARCore and WebXR. Default: "unknown".
             * @enum {string}
             */
            up?: "known" | "unknown";
            /**
             * Position Noise M
             * @description Standard deviation of the tracked position between images; it widens `accuracy`. Default: 0.01.
             */
            position_noise_m?: number;
            /**
             * Orientation Noise Deg
             * @description Standard deviation of the tracked orientation between images; it widens `accuracy`. Default: 0.5.
             */
            orientation_noise_deg?: number;
        };
        /**
         * Localized
         * @description One pose fits.
         */
        Localized: {
            /** Id */
            id: string;
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            status: "localized";
            /**
             * Placed By
             * @description `hand`: a person has placed the photo, see `POST /batches/{id}/images/{number}/pose`. Default: "engine".
             * @enum {string}
             */
            placed_by?: "engine" | "hand";
            /** Map Id */
            map_id: string;
            /** Map Revision */
            map_revision: number;
            /** @description Of the first image. */
            pose: components["schemas"]["PoseAnswer"];
            /** @description x_map = rotation · x_session + position, both sides in the axes of `frame`. For one image without a pose, the session frame is the camera frame. */
            map_from_session: components["schemas"]["RigidMotion"];
            /**
             * Images
             * @description One per image, in their order.
             */
            images: components["schemas"]["ImageAnswer"][];
            /** @description OGC GeoPose 1.0, Basic-Quaternion, of the first image: camera x forward, y left, z up. Null without a pose, for a map without a georeference, and if its heights are not above the ellipsoid. */
            geopose: components["schemas"]["GeoPose"] | null;
            /**
             * Confidence
             * @description Probability that the pose is within 0.3 m and 10 degrees.
             */
            confidence: number;
            accuracy: components["schemas"]["Accuracy"];
            /** Alternatives */
            alternatives: components["schemas"]["Alternative"][];
            change: components["schemas"]["Change"];
            /**
             * Timings S
             * @description Seconds per stage; `queue` and `total` as the caller sees them.
             */
            timings_s: {
                [key: string]: number;
            };
            /** Search */
            search: {
                [key: string]: unknown;
            };
            /**
             * Warnings
             * @description For people.
             */
            warnings: string[];
            /**
             * Reasons
             * @description For programs: what each of `warnings` says, or what the caller can do.
             */
            reasons?: ("accuracy_too_low" | "check_camera" | "check_image" | "hfov_contradicted" | "images_contradict" | "map_doubtful" | "map_left_out" | "map_not_ready" | "name_fewer_maps" | "not_kept" | "nothing_in_reach" | "placed_by_hand" | "places_look_alike" | "regions_ignored" | "turn_more" | "widen_hfov_range" | "widen_hints")[];
            /**
             * Artifacts
             * @description Paths of the requested pictures.
             */
            artifacts: {
                [key: string]: string;
            };
        };
        /**
         * Ambiguous
         * @description Several places look the same; those that are not the best are `alternatives`.
         */
        Ambiguous: {
            /** Id */
            id: string;
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            status: "ambiguous";
            /**
             * Placed By
             * @description `hand`: a person has placed the photo, see `POST /batches/{id}/images/{number}/pose`. Default: "engine".
             * @enum {string}
             */
            placed_by?: "engine" | "hand";
            /** Map Id */
            map_id: string;
            /** Map Revision */
            map_revision: number;
            /** @description Of the first image. */
            pose: components["schemas"]["PoseAnswer"];
            /** @description x_map = rotation · x_session + position, both sides in the axes of `frame`. For one image without a pose, the session frame is the camera frame. */
            map_from_session: components["schemas"]["RigidMotion"];
            /**
             * Images
             * @description One per image, in their order.
             */
            images: components["schemas"]["ImageAnswer"][];
            /** @description OGC GeoPose 1.0, Basic-Quaternion, of the first image: camera x forward, y left, z up. Null without a pose, for a map without a georeference, and if its heights are not above the ellipsoid. */
            geopose: components["schemas"]["GeoPose"] | null;
            /**
             * Confidence
             * @description Probability that the pose is within 0.3 m and 10 degrees.
             */
            confidence: number;
            accuracy: components["schemas"]["Accuracy"];
            /** Alternatives */
            alternatives: components["schemas"]["Alternative"][];
            change: components["schemas"]["Change"];
            /**
             * Timings S
             * @description Seconds per stage; `queue` and `total` as the caller sees them.
             */
            timings_s: {
                [key: string]: number;
            };
            /** Search */
            search: {
                [key: string]: unknown;
            };
            /**
             * Warnings
             * @description For people.
             */
            warnings: string[];
            /**
             * Reasons
             * @description For programs: what each of `warnings` says, or what the caller can do.
             */
            reasons?: ("accuracy_too_low" | "check_camera" | "check_image" | "hfov_contradicted" | "images_contradict" | "map_doubtful" | "map_left_out" | "map_not_ready" | "name_fewer_maps" | "not_kept" | "nothing_in_reach" | "placed_by_hand" | "places_look_alike" | "regions_ignored" | "turn_more" | "widen_hfov_range" | "widen_hints")[];
            /**
             * Artifacts
             * @description Paths of the requested pictures.
             */
            artifacts: {
                [key: string]: string;
            };
        };
        /**
         * NotLocalized
         * @description No pose fits well enough. The best guess, if there is one, is the first of `alternatives`.
         */
        NotLocalized: {
            /** Id */
            id: string;
            /**
             * @description discriminator enum property added by openapi-typescript
             * @enum {string}
             */
            status: "not_localized";
            /**
             * Placed By
             * @description `hand`: a person has placed the photo, see `POST /batches/{id}/images/{number}/pose`. Default: "engine".
             * @enum {string}
             */
            placed_by?: "engine" | "hand";
            /** Map Id */
            map_id: null;
            /** Map Revision */
            map_revision: null;
            /** Pose */
            pose: null;
            /** Map From Session */
            map_from_session: null;
            /**
             * Images
             * @description One per image, in their order.
             */
            images: components["schemas"]["ImageAnswer"][];
            /** Geopose */
            geopose: null;
            /**
             * Confidence
             * @description Probability that the pose is within 0.3 m and 10 degrees.
             */
            confidence: number;
            /** Accuracy */
            accuracy: null;
            /** Alternatives */
            alternatives: components["schemas"]["Alternative"][];
            change: components["schemas"]["Change"];
            /**
             * Timings S
             * @description Seconds per stage; `queue` and `total` as the caller sees them.
             */
            timings_s: {
                [key: string]: number;
            };
            /** Search */
            search: {
                [key: string]: unknown;
            };
            /**
             * Warnings
             * @description For people.
             */
            warnings: string[];
            /**
             * Reasons
             * @description For programs: what each of `warnings` says, or what the caller can do.
             */
            reasons?: ("accuracy_too_low" | "check_camera" | "check_image" | "hfov_contradicted" | "images_contradict" | "map_doubtful" | "map_left_out" | "map_not_ready" | "name_fewer_maps" | "not_kept" | "nothing_in_reach" | "placed_by_hand" | "places_look_alike" | "regions_ignored" | "turn_more" | "widen_hfov_range" | "widen_hints")[];
            /**
             * Artifacts
             * @description Paths of the requested pictures.
             */
            artifacts: {
                [key: string]: string;
            };
        };
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type $defs = Record<string, never>;
export type operations = Record<string, never>;
