import { computed, signal } from "@preact/signals";
import { api, resultOf, type Caller } from "../net/api";
import { findText } from "../texts/translate";

/** The signed-in caller; null: nobody; undefined: not requested yet. */
export const caller = signal<Caller | null | undefined>(undefined);

const RANKS = ["viewer", "operator", "maintainer"];

function atLeast(role: string) {
  return computed(() => RANKS.indexOf(caller.value?.role ?? "") >= RANKS.indexOf(role));
}

/** Whether the caller may scan. The service decides; the console only hides what is of no use. */
export const canOperate = atLeast("operator");
/** Whether the caller may acknowledge faults and calibrate. */
export const canMaintain = atLeast("maintainer");

/** Request the signed-in caller. */
export async function refreshSession(): Promise<void> {
  caller.value = (await resultOf(api.GET("/api/session"))).caller;
}

/** Start of every token. */
const TOKEN_PREFIX = "pct_";
/** A longer text is no code, even with spaces and dashes. */
const MAX_CODE_LENGTH = 20;

/** Return whether a text is a token and not a code, as far as its form says. */
export function isToken(text: string): boolean {
  return text.trim().startsWith(TOKEN_PREFIX) || text.trim().length > MAX_CODE_LENGTH;
}

/** Sign in with a code or a token. */
export async function signIn(text: string): Promise<void> {
  const body = isToken(text) ? { token: text } : { code: text };
  caller.value = (await resultOf(api.POST("/api/session", { body }))).caller;
}

/** Sign out of this browser. */
export async function signOut(): Promise<void> {
  await resultOf(api.DELETE("/api/session"));
  await refreshSession();
}

/** Return name and role of the caller, for people. */
export function callerNames(): { name: string; role: string } {
  const { name = "", role = "" } = caller.value ?? {};
  return { name, role: findText(`app.role_name.${role}`) ?? role };
}
