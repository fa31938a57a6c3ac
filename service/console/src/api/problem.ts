import type { Problem } from "./types.ts";

/** A failed request: the problem document of the service, or status 0 when it did not answer. */
export class RequestError extends Error {
  readonly problem: Problem;

  constructor(problem: Problem) {
    super(problem.detail);
    this.problem = problem;
  }

  get isUnreachable(): boolean {
    return this.problem.status === 0;
  }
}

export function unreachable(): RequestError {
  return new RequestError({
    type: "unreachable",
    title: "The service does not answer",
    status: 0,
    detail: "The page continues as soon as the service answers again.",
  });
}

/** An upload whose connection broke. Unlike a GET request, it is not repeated automatically. */
export function brokenOff(): RequestError {
  return new RequestError({
    type: "unreachable",
    title: "The connection was interrupted",
    status: 0,
    detail: "The upload did not arrive. Try again once the service answers.",
  });
}

/** Whether the same request may succeed later: the service was away, busy or at fault. */
export function mayPass(problem: Problem): boolean {
  return problem.status <= 0 || problem.status >= 500 || [404, 408, 409, 429].includes(problem.status);
}

/** Return the problem in a body, or one made of the status. */
export function problemOf(status: number, body: string): RequestError {
  try {
    const said = JSON.parse(body) as Partial<Problem>;
    if (typeof said.detail === "string") return new RequestError({ type: "", title: "The request failed", status, ...said, detail: said.detail });
  } catch {
    // Not from panoloc: a proxy's page, for example.
  }
  return new RequestError({ type: "", title: "The request failed", status, detail: `The service answered with status ${status}.` });
}

/** Return the problem to show for anything that was thrown. */
export function shown(error: unknown): Problem {
  if (error instanceof RequestError) return error.problem;
  return { type: "", title: "The console failed", status: -1, detail: String(error) };
}
