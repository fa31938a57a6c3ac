/** What the operations page shows of the Prometheus text. */

/** Return the sum of a metric over its labels, null where the text has none. */
export function total(text: string, name: string, label = ""): number | null {
  let sum: number | null = null;
  for (const line of text.split("\n")) {
    const match = /^(\w+)(\{[^}]*\})? ([^ ]+)/.exec(line);
    if (match?.[1] === name && (match[2] ?? "").includes(label)) sum = (sum ?? 0) + Number(match[3]);
  }
  return sum;
}
