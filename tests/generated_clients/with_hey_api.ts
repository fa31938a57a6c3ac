import { readFileSync } from "node:fs";
import { localize, type LocalizeOptions } from "./hey";
import { client } from "./hey/client.gen";

async function main(url: string, map: string, path: string): Promise<void> {
  client.setConfig({ baseUrl: url });
  const options: LocalizeOptions = { top_k: 2, timeout_s: 500 };
  // @ts-expect-error: a misspelt field
  const misspelt: LocalizeOptions = { topk: 2 };
  const image = new Blob([readFileSync(path)]);
  const { data, error } = await localize({ body: { image: [image], map_id: [map], options } });
  if (data?.status !== "localized") throw new Error(JSON.stringify(data ?? error));
  console.log(JSON.stringify(data.pose.map_from_camera.matrix));
}

void main(process.argv[2]!, process.argv[3]!, process.argv[4]!);
