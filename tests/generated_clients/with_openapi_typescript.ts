import { readFileSync } from "node:fs";
import createClient from "openapi-fetch";
import type { components, paths } from "./types";

async function main(url: string, map: string, path: string): Promise<void> {
  const client = createClient<paths>({ baseUrl: url });
  const options: components["schemas"]["LocalizeOptions"] = { top_k: 2, timeout_s: 500 };
  const { data, error } = await client.POST("/localize", {
    body: { image: [new Blob([readFileSync(path)])], map_id: [map], options },
    bodySerializer: (body) => {
      const form = new FormData();
      for (const image of body.image) form.append("image", image);
      for (const id of body.map_id ?? []) form.append("map_id", id);
      form.append("options", JSON.stringify(body.options));
      return form;
    },
  });
  if (data?.status !== "localized") throw new Error(JSON.stringify(data ?? error));
  // @ts-expect-error: a misspelt field
  if (data.pose.map_from_camra) throw new Error();
  console.log(JSON.stringify(data.pose.map_from_camera.matrix));
}

void main(process.argv[2]!, process.argv[3]!, process.argv[4]!);
