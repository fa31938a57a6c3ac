import type { Problem } from "./types.ts";

/** A request that did not end well: what the service said, or that it did not answer at all (status 0). */
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
    detail: "Nothing came back. The page goes on by itself as soon as the service is there again.",
  });
}

/** An upload whose connection broke: unlike a request that only asks, it is not sent again by itself. */
export function brokenOff(): RequestError {
  return new RequestError({
    type: "unreachable",
    title: "The connection broke off",
    status: 0,
    detail: "The upload did not get through. Try again once the service is there.",
  });
}

/** Whether the same request may well end otherwise later: the service was away, busy or at fault, not the request. */
export function mayPass(problem: Problem): boolean {
  return problem.status <= 0 || problem.status >= 500 || [404, 408, 409, 429].includes(problem.status);
}

/** Return the problem that a body says, or one made of the status where it says none. */
export function problemOf(status: number, body: string): RequestError {
  try {
    const said = JSON.parse(body) as Partial<Problem>;
    if (typeof said.detail === "string") return new RequestError({ type: "", title: "The request failed", status, ...said, detail: said.detail });
  } catch {
    // Not of this service: a proxy's page, for example.
  }
  return new RequestError({ type: "", title: "The request failed", status, detail: `The service answered with status ${status}.` });
}

/** Return what to show of anything that was thrown. */
export function shown(error: unknown): Problem {
  if (error instanceof RequestError) return error.problem;
  return { type: "", title: "The console met a fault", status: -1, detail: String(error) };
}
