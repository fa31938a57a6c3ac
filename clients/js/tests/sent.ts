/** What the package makes of a view of WebXR and of a point of the scan: JSON from standard input, for tests/docs/ar_devices.py. */

import { json } from "node:stream/consumers";
import { entryOf, motionOf, scanPoint, Tracker, type LocalizeOptions, type Localization, type View } from "../src/index.ts";

const { view, point } = (await json(process.stdin)) as { view: View; point: [number, number, number] };
let time_s = 0;
const options = await new Promise<LocalizeOptions | undefined>((sent) => {
  const localize = (_: unknown, query: { options?: LocalizeOptions | undefined }): Promise<Localization> => (sent(query.options), new Promise(() => undefined));
  const capture = () => ({ image: new Blob(), camera: entryOf(view) });
  const tracker = new Tracker({ service: { localize }, mapId: "map_1", capture, now: () => time_s });
  for (; time_s < 5; time_s += 1) tracker.update(motionOf(view.transform));
});
console.log(JSON.stringify({ options, content: Object.values(scanPoint(...point)) }));
